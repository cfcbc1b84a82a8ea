//! Focus measures: how sharp a grey picture is.
