//! What the program leaves behind for its next start: why it panicked, or that the bootloader is wanted.
//!
//! It lies in RAM that the start-up code does not clear (`.uninit`, cortex-m-rt), and survives every reset but a loss of power.

use core::cell::UnsafeCell;
use core::fmt::Write;
use core::mem::MaybeUninit;
use core::sync::atomic::{Ordering, compiler_fence};

const PANICKED: u32 = 0x7061_6e69;
const BOOTLOADER: u32 = 0x6466_7521;
const TEXT: usize = 160;

/// A message to the next start. Every bit pattern is a valid value, so that whatever the RAM held is one too.
#[repr(C)]
struct Letter {
    kind: u32,
    /// The complement of `kind`: after power-on the RAM holds anything, but hardly this.
    check: u32,
    length: u32,
    text: [u8; TEXT],
}

struct Kept(UnsafeCell<MaybeUninit<Letter>>);

// SAFETY: written only where nothing else runs any more (panic, reset), read only before anything else runs.
unsafe impl Sync for Kept {}

#[unsafe(link_section = ".uninit.letter")]
static LETTER: Kept = Kept(UnsafeCell::new(MaybeUninit::uninit()));

fn letter() -> *mut Letter {
    LETTER.0.get().cast()
}

/// What the last run said before it ended.
pub enum LastWords {
    /// It ended without a word: power, the reset pin, the watchdog.
    Nothing,
    /// It panicked; the text is in the buffer.
    Panic(Text),
    /// It asked for the bootloader.
    Bootloader,
}

/// A short text, cut at its end.
pub struct Text {
    bytes: [u8; TEXT],
    length: usize,
}

impl Text {
    const fn new() -> Self {
        Self { bytes: [0; TEXT], length: 0 }
    }

    /// The text as far as it is UTF-8.
    pub fn as_str(&self) -> &str {
        let bytes = &self.bytes[..self.length];
        match core::str::from_utf8(bytes) {
            Ok(text) => text,
            Err(e) => core::str::from_utf8(&bytes[..e.valid_up_to()]).unwrap_or(""),
        }
    }
}

impl Write for Text {
    fn write_str(&mut self, s: &str) -> core::fmt::Result {
        let room = &mut self.bytes[self.length..];
        let n = room.len().min(s.len());
        room[..n].copy_from_slice(&s.as_bytes()[..n]);
        self.length += n;
        Ok(())
    }
}

/// Takes what the last run said, once.
pub fn take() -> LastWords {
    // SAFETY: called first thing after the start, with no other access; volatile, as the compiler knows nothing of the
    // earlier run's writes, and every bit pattern is a valid `Letter`.
    let found = unsafe { letter().read_volatile() };
    leave(0, &Text::new());
    match found.kind {
        kind if found.check != !kind => LastWords::Nothing,
        PANICKED => LastWords::Panic(Text { bytes: found.text, length: (found.length as usize).min(TEXT) }),
        BOOTLOADER => LastWords::Bootloader,
        _ => LastWords::Nothing,
    }
}

/// Keeps the reason of a panic for the next start.
pub fn keep_panic(reason: impl core::fmt::Display) {
    let mut text = Text::new();
    let _ = write!(text, "{reason}");
    leave(PANICKED, &text);
}

/// Asks the next start to enter the bootloader.
pub fn ask_for_bootloader() {
    leave(BOOTLOADER, &Text::new());
}

fn leave(kind: u32, text: &Text) {
    let new = Letter { kind, check: !kind, length: text.length as u32, text: text.bytes };
    // SAFETY: called before anything else runs (`take`) or when nothing else will (panic, reset).
    unsafe { letter().write_volatile(new) };
    compiler_fence(Ordering::SeqCst);
}
