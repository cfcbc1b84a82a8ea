//! `parfocal serve`: the operator page.

use super::camera::simulated_timing;
use super::connection::{Connection, Purpose, fresh_session};
use super::paced::Paced;
use super::{Output, interrupt, simulated};
use anyhow::{Context, bail};
use parfocal::frames::address::{CAREFUL_LATENCY, CameraAddress};
use parfocal::frames::camera::{Camera, CameraError};
use parfocal::frames::stack::Stack;
use parfocal::link::transport::Transport;
use parfocal::page::feed::Open;
use parfocal::page::line::Line;
use parfocal::page::{ADDRESS, Options, Page};
use parfocal::rig::{self, AxisName, Coordinate, Device, Moves, Rig};
use parfocal_protocol::message::Session;
use std::io::Write;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

/// Serve the operator page: live picture, axes, autofocus and calibration in a browser
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Where to serve it; an address that other computers reach needs a --token
    #[arg(long, default_value_t = ADDRESS, value_name = "ADDRESS:PORT")]
    listen: SocketAddr,
    /// Asked of every browser and script
    #[arg(long, value_name = "TOKEN")]
    token: Option<String>,
    /// A name by which browsers may call this computer, besides its address
    #[arg(long, value_name = "NAME")]
    name: Vec<String>,
    /// Where frames come from: sim, exec:COMMAND, v4l:DEVICE, y4m:FILE, folder:DIR, stack:DIR [default: sim on the simulated rig]
    #[arg(long, value_name = "SOURCE")]
    camera: Option<CameraAddress>,
    /// Longest time from the begin of an exposure to its frame's arrival, for cameras that do not tell
    #[arg(long, value_name = "MS", default_value_t = CAREFUL_LATENCY.as_millis() as u64)]
    camera_latency_ms: u64,
}

impl Arguments {
    /// Runs the command until Ctrl-C.
    ///
    /// # Errors
    /// What is wrong with the address, a port, the camera or the rig's file.
    pub fn run(self, connection: &Connection, out: Output) -> anyhow::Result<()> {
        interrupt::watch();
        let stack = match &self.camera {
            Some(CameraAddress::Stack(path)) => Some(Arc::new(Stack::open(path)?)),
            _ => None,
        };
        let timing = simulated_timing(self.camera.as_ref())?;
        let mut model = simulated::Model { seed: connection.seed, timing, ..simulated::Model::default() };
        if let Some(stack) = &stack {
            let (low, high) = stack.extent();
            let axis = AxisName { device: Device::Scope, coordinate: Coordinate::Z };
            model.limits.push((axis, low, high));
            model.positions.push((axis, low));
        }
        let paced = connection.simulated(model)?.map(Paced::new);
        let mut watchers = Vec::new();
        let mut wrap = |transport: Box<dyn Transport>| -> Box<dyn Transport> {
            let line = Line::new(transport, Session(fresh_session()));
            watchers.push(line.watcher());
            Box::new(line)
        };
        let boards = paced.as_ref().map(|paced| paced as &dyn simulated::Boards);
        let stage = connection.stage(Purpose::Control, boards, &mut wrap)?;
        let (camera, camera_name) = self.open(paced.as_ref(), stack)?;
        let page = Page::serve(Options {
            listen: self.listen,
            token: self.token.clone(),
            names: self.name.clone(),
            watchers,
            camera,
            camera_name,
            simulated: paced.is_some(),
            rig: self.rig(connection, &stage, paced.as_ref())?,
            rig_path: connection.rig.clone(),
            turret: paced.as_ref().map(Paced::turret),
            stage,
        })?;
        let mut address = format!("http://{}/", page.address());
        if let Some(token) = &self.token {
            address.push_str(&format!("?token={token}"));
        }
        let text = format!("the operator page is at {address}\n(Ctrl-C ends it)");
        out.result(&text, &serde_json::json!({ "address": address }))?;
        std::io::stdout().flush()?;
        while interrupt::keep_on() {
            std::thread::sleep(Duration::from_millis(50));
        }
        drop(page);
        Ok(())
    }

    fn open(&self, paced: Option<&Paced>, stack: Option<Arc<Stack>>) -> anyhow::Result<(Open, String)> {
        let address = match (&self.camera, paced) {
            (Some(address), _) => address.clone(),
            (None, Some(_)) => CameraAddress::Simulated(String::new()),
            (None, None) => bail!("a real rig needs a --camera: docs/cameras.md has examples"),
        };
        let name = address.to_string();
        let latency = Duration::from_millis(self.camera_latency_ms);
        let open: Open = match (&address, paced, stack) {
            (CameraAddress::Simulated(_), Some(paced), _) => {
                let paced = paced.clone();
                Box::new(move || Ok(Box::new(paced.camera()) as Box<dyn Camera>))
            }
            (CameraAddress::Stack(_), Some(paced), Some(stack)) => {
                let paced = paced.clone();
                Box::new(move || Ok(Box::new(paced.stack_camera(stack.clone())) as Box<dyn Camera>))
            }
            (CameraAddress::Simulated(_) | CameraAddress::Stack(_), ..) => {
                bail!("{name} belongs to the simulated rig: leave --port and --rig out, or choose a real --camera")
            }
            (CameraAddress::Curve(_), ..) => bail!("{name} is a curve without pictures: `parfocal autofocus` takes it"),
            _ => Box::new(move || {
                let none = || CameraError::Ended { camera: address.to_string(), reason: "it needs a rig".into() };
                address.open(Some(latency))?.ok_or_else(none)
            }),
        };
        Ok((open, name))
    }

    /// The rig's file, or what is known without one.
    fn rig(
        &self,
        connection: &Connection,
        stage: &parfocal::stage::Stage,
        paced: Option<&Paced>,
    ) -> anyhow::Result<Rig> {
        if let Some(path) = &connection.rig {
            return Rig::load(path).with_context(|| path.display().to_string());
        }
        let mut rig = Rig::new();
        let contents = rig.contents_mut();
        for (name, place) in stage.axes() {
            let board = format!("board{}", place.board);
            let moves = (name.device == Device::Scope).then_some(Moves::Objective);
            let axis = rig::Axis { board, index: place.axis.0, moves };
            contents.axes.entry(name.device).or_default().insert(name.coordinate, axis);
        }
        for (i, number) in (0u8..).zip(boards(contents)) {
            // Without a file nobody looks a board up by its id; each has one all the same.
            contents.boards.insert(number, rig::Board { unique_id: format!("{i:02x}").parse()? });
        }
        if let Some(paced) = paced {
            for (name, depth) in paced.objectives() {
                let default = contents.objectives.is_empty();
                let objective = rig::Objective { default, depth_of_field_um: Some(depth), zooms: Vec::new() };
                contents.objective_in_use.get_or_insert_with(|| name.clone());
                contents.objectives.insert(name, objective);
            }
            let (width_px, height_px) = paced.sensor();
            contents.camera =
                Some(rig::Camera { width_px, height_px, crop_px: None, binning: 1, calibration: None, latency: None });
        }
        if contents.objectives.is_empty() {
            let default = rig::Objective { default: true, ..rig::Objective::default() };
            contents.objectives.insert("default".into(), default);
            contents.objective_in_use = Some("default".into());
        }
        Ok(rig)
    }
}

fn boards(contents: &rig::Contents) -> std::collections::BTreeSet<String> {
    contents.axes.values().flat_map(|axes| axes.values().map(|axis| axis.board.clone())).collect()
}
