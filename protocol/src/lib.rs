//! What a Parfocal board and its host say to each other.
#![no_std]
