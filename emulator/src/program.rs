//! The ELF: where its functions and variables lie.

use anyhow::Context;
use object::{Object, ObjectSymbol};
use std::path::Path;

/// Symbols of a program.
#[derive(Clone, Debug)]
pub struct Program {
    symbols: Vec<(String, u64)>,
}

impl Program {
    /// Reads an ELF's symbols.
    ///
    /// # Errors
    /// When the file cannot be read, or is not an ELF.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        let file = object::File::parse(&*bytes).with_context(|| format!("{} is not an ELF", path.display()))?;
        let symbols = file
            .symbols()
            .filter_map(|s| Some((format!("{:#}", rustc_demangle::demangle(s.name().ok()?)), s.address())))
            .collect();
        Ok(Self { symbols })
    }

    /// The address of a function or variable, by its whole path; of a function, its first instruction.
    ///
    /// # Errors
    /// When there is no such symbol.
    pub fn address(&self, path: &str) -> anyhow::Result<u64> {
        let found = self.symbols.iter().find(|(name, _)| name == path);
        // Bit 0 of a function's address only says 'Thumb'.
        found.map(|(_, at)| at & !1).with_context(|| format!("the program has no symbol '{path}'"))
    }
}
