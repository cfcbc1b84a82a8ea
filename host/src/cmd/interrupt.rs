//! Ctrl-C: what moves is stopped with a deceleration, what runs ends cleanly. A second Ctrl-C ends the program at once;
//! the boards then stop by themselves because they hear nothing any more.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

static PRESSED: AtomicBool = AtomicBool::new(false);
static WATCHED: OnceLock<()> = OnceLock::new();

/// Begins to watch for Ctrl-C.
pub fn watch() {
    WATCHED.get_or_init(|| {
        std::thread::spawn(|| {
            let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else { return };
            runtime.block_on(async {
                if tokio::signal::ctrl_c().await.is_ok() {
                    eprintln!("\nstopping; Ctrl-C again to leave at once");
                    PRESSED.store(true, Ordering::SeqCst);
                }
                if tokio::signal::ctrl_c().await.is_ok() {
                    std::process::exit(1);
                }
            });
        });
    });
}

/// False from the first Ctrl-C on.
pub fn keep_on() -> bool {
    !PRESSED.load(Ordering::SeqCst)
}
