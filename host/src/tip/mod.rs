//! Detection of micropipette tips in camera frames.
