//! What host-in-the-loop tests share. The tests themselves are in `tests/tests`.

use std::path::PathBuf;

/// The folder of real stacks and points: `PARFOCAL_DATA`, or `../shared/data` beside the project.
///
/// A test that needs it carries `#[cfg_attr(not(shared_data), ignore = "needs real data: set PARFOCAL_DATA")]`.
///
/// # Panics
/// When the folder is not there: under CI that is a failure with this sentence, elsewhere such tests are ignored.
pub fn shared_data(name: &str) -> PathBuf {
    let folder = std::env::var_os("PARFOCAL_DATA")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from);
    let path = folder.join(name);
    assert!(path.exists(), "{} is missing: set PARFOCAL_DATA to the folder of real stacks", path.display());
    path
}
