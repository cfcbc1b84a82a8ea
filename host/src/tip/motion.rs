//! Finds a pipette by its vibration.
