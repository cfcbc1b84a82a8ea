//! A virtual rig.
