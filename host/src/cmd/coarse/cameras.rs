//! Stereo pairs from two running cameras, kept as the files that `--pairs` reads, with where the axes stood.

use super::{Arguments, folder, simulated};
use crate::cmd::connection::{Bench, Connection, Purpose};
use crate::cmd::simulated::Model;
use anyhow::{Context, bail};
use parfocal::calibration::coarse::{Place, Side};
use parfocal::frames::address::{CAREFUL_LATENCY, CameraAddress};
use parfocal::frames::camera::{Camera, Frame};
use parfocal::link::transport::{later, real_now};
use parfocal::picture::{Data, Picture};
use parfocal::rig::Rig;
use parfocal_protocol::units::HostTime;
use std::io::{BufRead, Write};
use std::path::Path;

/// How long to wait for a frame, ms.
const PATIENCE_MS: u64 = 5000;
/// Exposures farther apart than this are told, ms.
const APART_MS: u64 = 20;

/// Takes pairs into a new folder, and keeps where the rig's axes stood.
///
/// # Errors
/// A camera or board that cannot be opened or stops, a folder that has pairs already, a person who ends it.
pub(super) fn take(arguments: &Arguments, folder: &Path, rig: Option<&Rig>, from: &Connection) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    if std::fs::read_dir(folder)?.flatten().any(|f| f.file_name().to_string_lossy().starts_with("place_")) {
        bail!("{} holds pairs already: name a new folder, or leave the cameras away to use them", folder.display());
    }
    let connection = Connection { rig: arguments.rig.clone(), ..from.clone() };
    let has_axes = rig.is_some_and(|rig| !rig.contents().axes.is_empty());
    let simulated = arguments.cameras.iter().all(|camera| matches!(camera, CameraAddress::Simulated(_)));
    let bench = (simulated || has_axes)
        .then(|| connection.open(Purpose::Look, Model { seed: connection.seed, ..Model::default() }))
        .transpose()?;
    match (&bench, &arguments.cameras[..]) {
        (Some(Bench { simulated: Some(handle), .. }), _) if simulated => {
            let clicks = simulated::take(handle, arguments.places, folder, seed_of(folder, connection.seed))?;
            folder::write(folder, folder::CLICKS, &clicks)?;
        }
        (_, [left, right]) if !simulated => by_a_person([left, right], arguments.places, folder)?,
        (_, [_]) if !simulated => {
            bail!("a stereo camera is two cameras: --cameras LEFT RIGHT, or sim for the simulated rig's")
        }
        _ => bail!("sim is the simulated rig's stereo camera: this is another rig, name its two cameras"),
    }
    if let (Some(Bench { mut stage, .. }), Some(rig)) = (bench, rig) {
        let now = folder::NowFile::of(&mut stage, rig);
        stage.close();
        folder::write(folder, folder::NOW, &now?)?;
    }
    Ok(())
}

/// Another folder, another way of holding the camera; the same one again, the same pictures (FNV-1a).
fn seed_of(folder: &Path, seed: u64) -> u64 {
    let name = folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325, |h: u64, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
    hash.wrapping_add(seed)
}

/// Takes a pair at every place that a person puts the stereo camera to.
fn by_a_person(cameras: [&CameraAddress; 2], places: u32, folder: &Path) -> anyhow::Result<()> {
    let open = |address: &CameraAddress| -> anyhow::Result<Box<dyn Camera>> {
        let camera = address.open(Some(CAREFUL_LATENCY))?;
        camera.with_context(|| format!("{address} is no camera that runs by itself: docs/cameras.md has examples"))
    };
    let (mut left, mut right) = (open(cameras[0])?, open(cameras[1])?);
    for k in 1..=places {
        eprint!("Put the stereo camera to place {k} of {places}, hold it still, press Enter ('q' ends): ");
        std::io::stderr().flush().ok();
        let mut line = String::new();
        if std::io::stdin().lock().read_line(&mut line)? == 0 || line.trim() == "q" {
            bail!("ended after {} of {places} places; the pairs taken are in {}", k - 1, folder.display());
        }
        let since = real_now();
        let pair = [fresh(left.as_mut(), since)?, fresh(right.as_mut(), since)?];
        if let Some(apart) = apart_ms(&pair).filter(|apart| *apart > APART_MS) {
            eprintln!("place {k}: left and right were exposed {apart} ms apart: that is no harm if nothing moved");
        }
        for (side, frame) in Side::BOTH.into_iter().zip(&pair) {
            let path = folder.join(format!("place_{}_{side}.png", Place(k)));
            save(&frame.picture, &path).with_context(|| format!("{}: cannot be written", path.display()))?;
        }
    }
    Ok(())
}

/// The first frame exposed after a moment; of a camera that does not tell, the second that arrived.
fn fresh(camera: &mut dyn Camera, since: HostTime) -> anyhow::Result<Frame> {
    let deadline = later(since, PATIENCE_MS);
    let mut arrived = 0;
    while let Some(frame) = camera.next_frame(deadline)? {
        arrived += usize::from(frame.arrival >= since);
        match frame.exposure {
            Some((begin, _)) if begin >= since => return Ok(frame),
            None if arrived > 1 => return Ok(frame),
            _ => {}
        }
    }
    bail!("the camera {} gave no fresh frame within {PATIENCE_MS} ms: check its cable", camera.name())
}

/// Between the begins of the two exposures.
fn apart_ms([left, right]: &[Frame; 2]) -> Option<u64> {
    let begin = |f: &Frame| f.exposure.map(|(begin, _)| begin.0);
    Some(begin(left)?.abs_diff(begin(right)?) / 1000)
}

/// Writes a picture as it is, 8 or 16 bits.
fn save(picture: &Picture, path: &Path) -> anyhow::Result<()> {
    let (w, h) = (picture.width as u32, picture.height as u32);
    let size = "a picture has as many values as pixels";
    match &picture.data {
        Data::Grey8(data) => image::GrayImage::from_raw(w, h, data.clone()).context(size)?.save(path)?,
        Data::Grey16(data) => {
            image::ImageBuffer::<image::Luma<u16>, _>::from_raw(w, h, data.clone()).context(size)?.save(path)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use parfocal::frames::camera::CameraError;

    /// Frames at 0, 10, 20 … ms, with or without exposure times.
    struct Ticking(u64, bool);

    impl Camera for Ticking {
        fn name(&self) -> String {
            "ticking".into()
        }

        fn next_frame(&mut self, deadline: HostTime) -> Result<Option<Frame>, CameraError> {
            let begin = 10_000 * self.0;
            self.0 += 1;
            let exposure = self.1.then_some((HostTime(begin), HostTime(begin + 5_000)));
            let picture = Picture::grey8(2, 1, vec![self.0 as u8, 0]).unwrap();
            let frame = Frame { picture: picture.into(), number: self.0, exposure, arrival: HostTime(begin + 8_000) };
            Ok((frame.arrival <= deadline).then_some(frame))
        }
    }

    #[test]
    fn frames_from_before_the_camera_stood_still_are_thrown_away() {
        let told = fresh(&mut Ticking(0, true), HostTime(32_000)).unwrap();
        assert_eq!(told.exposure.unwrap().0, HostTime(40_000));
        // Arrived at 38 and 48 ms; the first may have been exposed before.
        let untold = fresh(&mut Ticking(0, false), HostTime(32_000)).unwrap();
        assert_eq!(untold.arrival, HostTime(48_000));
        assert_eq!(apart_ms(&[told.clone(), told]), Some(0));
    }

    #[test]
    fn pictures_are_kept_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("place_1_left.png");
        let picture = Picture::grey16(2, 1, vec![40_000, 7]).unwrap();
        save(&picture, &path).unwrap();
        assert_eq!(parfocal::frames::image_file::read(&path).unwrap().0.data, picture.data);
    }
}
