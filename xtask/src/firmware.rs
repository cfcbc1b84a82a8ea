//! `cargo xtask firmware`: builds what is flashed, and says how much of the chip it takes.

use crate::run::{cargo, check, root};
use anyhow::Context;
use object::{Object, ObjectSection, SectionFlags, elf};
use std::path::PathBuf;

/// Builds the firmware and prints the flash and RAM it takes
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Print one JSON object on stdout
    #[arg(long)]
    json: bool,
}

/// The chip.
const TARGET: &str = "thumbv7em-none-eabihf";

/// Flash and RAM that a firmware takes, bytes.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Size {
    /// What is written to flash: code, constants and the initial values of variables.
    pub flash_bytes: u64,
    /// Variables, whether initialised, zeroed or left alone. The stack has the rest.
    pub ram_bytes: u64,
}

impl Arguments {
    /// Builds, measures, prints.
    ///
    /// # Errors
    /// When the firmware does not build.
    pub fn run(&self) -> anyhow::Result<()> {
        let elf = build()?;
        let size = size(&elf)?;
        let shown = elf.strip_prefix(root()).unwrap_or(&elf).display();
        let people = format!(
            "{shown}: {:.1} KiB of flash, {:.1} KiB of RAM",
            size.flash_bytes as f64 / 1024.0,
            size.ram_bytes as f64 / 1024.0
        );
        if self.json {
            eprintln!("{people}");
            println!("{}", serde_json::to_string(&size)?);
        } else {
            println!("{people}");
        }
        Ok(())
    }
}

/// Builds the ELF that is flashed and emulated: there is no other.
///
/// # Errors
/// When it does not build.
pub fn build() -> anyhow::Result<PathBuf> {
    check(cargo().args(["build", "--package", "parfocal-firmware", "--profile", "firmware", "--target", TARGET]))?;
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from);
    Ok(target.join(TARGET).join("firmware").join("parfocal-firmware"))
}

/// Adds up an ELF's sections.
///
/// # Errors
/// When the file cannot be read or is not an ELF.
pub fn size(path: &PathBuf) -> anyhow::Result<Size> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let file = object::File::parse(&*bytes).with_context(|| format!("{} is not an ELF file", path.display()))?;
    let mut size = Size { flash_bytes: 0, ram_bytes: 0 };
    for section in file.sections() {
        let SectionFlags::Elf { sh_flags } = section.flags() else { continue };
        if sh_flags & u64::from(elf::SHF_ALLOC) == 0 {
            continue;
        }
        // RAM lies at 0x2000_0000; initialised variables also take flash, for their initial values.
        let in_ram = section.address() >= 0x2000_0000;
        let stored = section.kind() != object::SectionKind::UninitializedData && section.file_range().is_some();
        if in_ram {
            size.ram_bytes += section.size();
        }
        if stored {
            size.flash_bytes += section.size();
        }
    }
    Ok(size)
}
