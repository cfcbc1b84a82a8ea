//! The operator page: what the camera sees, where the axes are, and everything that moves them, in a browser on this computer.
//!
//! One thread drives the boards ([`driver`]), one reads the camera ([`feed`]), one publishes what there is to see
//! ([`snapshot`]); the web server only translates. A slow browser misses pictures and never slows anything down. STOP goes
//! past the driving thread, straight to the boards ([`mod@line`]).

mod api;
mod api_calibration;
mod assets;
mod body;
mod calibrating;
pub mod control;
pub mod desk;
mod driver;
pub mod feed;
mod focusing;
mod front;
pub mod jog;
mod jpeg;
mod known;
pub mod line;
mod order;
mod places;
pub mod security;
mod snapshot;
mod socket;
mod solving;
mod turret;
mod wizard;

use crate::rig::Rig;
use crate::stage::{Stage, StageError};
use desk::{AxisInfo, Desk, Setup};
use driver::Driver;
use feed::{Feed, Open};
use line::Watcher;
use security::{Rules, Unsafe};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::channel;
use thiserror::Error;
pub use turret::Turret;

/// Where the page is served unless another address is asked for.
pub const ADDRESS: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 8321);

/// Why there is no page.
#[derive(Debug, Error)]
pub enum PageError {
    /// It would not be safe.
    #[error(transparent)]
    Unsafe(#[from] Unsafe),
    /// The address cannot be listened at.
    #[error(
        "{address} cannot be listened at: {source}; another program has it, or it is not this computer's: choose another with --listen"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// What the system says.
        source: std::io::Error,
    },
    /// The axes.
    #[error(transparent)]
    Stage(#[from] StageError),
    /// The system gives no threads.
    #[error("the web server cannot be started: {0}")]
    Runtime(std::io::Error),
}

/// What a page needs.
pub struct Options {
    /// Where to listen; port 0 lets the system choose one.
    pub listen: SocketAddr,
    /// Asked of every request.
    pub token: Option<String>,
    /// Names by which this server may be called besides its address.
    pub names: Vec<String>,
    /// The axes, on links over [`line::Line`]s.
    pub stage: Stage,
    /// The lines' watchers, in the order of the stage's boards.
    pub watchers: Vec<Watcher>,
    /// Opens the camera.
    pub camera: Open,
    /// What it is called.
    pub camera_name: String,
    /// Whether this is the simulated rig.
    pub simulated: bool,
    /// The rig's file.
    pub rig: Rig,
    /// Where it is kept.
    pub rig_path: Option<PathBuf>,
    /// The microscope's own turret, if it has one.
    pub turret: Option<Turret>,
}

/// A page that is being served. Dropping it stops what moves and ends it.
pub struct Page {
    address: SocketAddr,
    desk: Arc<Desk>,
    driver: Option<std::thread::JoinHandle<()>>,
    runtime: Option<tokio::runtime::Runtime>,
}

impl Page {
    /// Starts serving.
    ///
    /// # Errors
    /// [`PageError`]; nothing has been started then.
    pub fn serve(mut options: Options) -> Result<Self, PageError> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .map_err(PageError::Runtime)?;
        // Refused before anything else is touched; the port is known once it is open.
        Rules::new(options.listen, options.token.clone(), options.names.clone())?;
        let address = options.listen;
        let listener = runtime
            .block_on(tokio::net::TcpListener::bind(address))
            .map_err(|source| PageError::Listen { address, source })?;
        let address = listener.local_addr().map_err(|source| PageError::Listen { address, source })?;
        let rules = Rules::new(address, options.token, options.names)?;
        let names: Vec<_> = options.stage.axes().collect();
        let mut axes = Vec::new();
        for (name, place) in names {
            axes.push(AxisInfo { name, place, settings: options.stage.settings(name)? });
        }
        let desk = Arc::new(Desk::new(Setup {
            axes,
            watchers: options.watchers,
            feed: Feed::start(options.camera),
            camera: options.camera_name,
            simulated: options.simulated,
            rig: options.rig,
            rig_path: options.rig_path,
            turret: options.turret,
        }));
        let (orders, inbox) = channel();
        let driver = Driver::start(desk.clone(), options.stage, inbox);
        let states = snapshot::publish(desk.clone());
        let app = front::App::new(desk.clone(), orders, states, rules);
        runtime.spawn(front::serve(listener, app));
        Ok(Self { address, desk, driver: Some(driver), runtime: Some(runtime) })
    }

    /// Where it is served.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What everybody sees.
    pub fn desk(&self) -> &Arc<Desk> {
        &self.desk
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        self.desk.close();
        if let Some(driver) = self.driver.take() {
            // A thread that panicked has told so.
            let _ = driver.join();
        }
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(std::time::Duration::from_millis(500));
        }
    }
}
