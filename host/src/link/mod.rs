//! The connection to a board.
