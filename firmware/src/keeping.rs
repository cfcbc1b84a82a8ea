//! Settings and resting positions in flash: what is kept over a power cycle, and in which form.
//!
//! Every record carries the version of its form. A record of an older form is migrated when it is read; one of a newer
//! form, left by a firmware that was since downgraded, counts as not there. [sequential-storage] does the rest: records
//! are appended and checked by CRC, so a power cut leaves the old value or the new one, and wear is spread over the pages.
//!
//! [sequential-storage]: https://docs.rs/sequential-storage

mod forms;

use crate::ports::{Keep, Kept, RestingPosition};
use core::ops::Range;
use embedded_storage_async::nor_flash::NorFlash;
use forms::{Position, Record, VERSION};
use parfocal_protocol::units::Steps;
use postcard::experimental::max_size::MaxSize;
use sequential_storage::Error;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};
use serde::Serialize;

/// Keys of the records: the axes' settings lie at 0, 1, 2, …
const BOARD: u8 = 0x40;
/// See [`BOARD`].
const POSITION: u8 = 0x41;

/// Longest record: key, version and an axis' settings, rounded up to words, with room for what later versions add.
const BUFFER: usize = 256;
const _: () = assert!(parfocal_protocol::settings::AxisSettings::POSTCARD_MAX_SIZE + 8 < BUFFER);

/// Records in a flash, or a part of one.
pub struct Store<S: NorFlash> {
    map: MapStorage<u8, S, NoCache>,
}

/// Nothing cached: settings are read once and written seldom.
type NoCache = Cache<Uncached, Uncached, Uncached, u8>;

/// Something could not be kept: the flash refused, or is worn out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CannotKeep;

impl<S: NorFlash> Store<S> {
    /// Uses the pages in `range`, at least two of them.
    ///
    /// # Panics
    /// When the range does not lie on page borders or is too small: a mistake in the program.
    pub fn new(flash: S, range: Range<u32>) -> Self {
        Self { map: MapStorage::new(flash, MapConfig::new(range), Cache::new_uncached()) }
    }

    /// Reads everything that was kept. What cannot be read counts as never kept.
    pub async fn load(&mut self) -> Kept {
        let mut kept = Kept::default();
        for (key, axis) in (0..).zip(&mut kept.axes) {
            *axis = self.read(key).await;
        }
        kept.board = self.read(BOARD).await;
        let position: Option<Position> = self.read(POSITION).await;
        kept.position =
            position.flatten().map(|p| p.map(|(steps, known)| RestingPosition { steps: Steps(steps), known }));
        kept
    }

    /// Writes one thing.
    ///
    /// # Errors
    /// [`CannotKeep`]; what was kept before still holds.
    pub async fn keep(&mut self, what: &Keep) -> Result<(), CannotKeep> {
        match what {
            Keep::Axis(axis, settings) => self.write(*axis as u8, settings).await,
            Keep::Board(settings) => self.write(BOARD, settings).await,
            Keep::Position(position) => {
                self.write(POSITION, &position.map(|p| p.map(|axis| (axis.steps.0, axis.known)))).await
            }
        }
    }

    async fn read<T: Record>(&mut self, key: u8) -> Option<T> {
        let mut buffer = [0; BUFFER];
        match self.map.fetch_item::<&[u8]>(&mut buffer, &key).await {
            Ok(Some([version, record @ ..])) => T::read(*version, record),
            Ok(_) | Err(_) => None,
        }
    }

    async fn write<T: Serialize>(&mut self, key: u8, value: &T) -> Result<(), CannotKeep> {
        let mut record = [0; BUFFER];
        record[0] = VERSION;
        let n = 1 + postcard::to_slice(value, &mut record[1..]).map_err(|_| CannotKeep)?.len();
        let mut buffer = [0; BUFFER];
        match self.map.store_item(&mut buffer, &key, &&record[..n]).await {
            Ok(()) => Ok(()),
            Err(Error::Storage { .. }) => Err(CannotKeep),
            // Our few records always fit: what lies in these pages is not ours, or damaged beyond reading. Begin afresh.
            Err(_) => {
                self.map.erase_all().await.map_err(|_| CannotKeep)?;
                self.map.store_item(&mut buffer, &key, &&record[..n]).await.map_err(|_| CannotKeep)
            }
        }
    }
}

#[cfg(test)]
mod tests;
