//! Serves views of an image database over HTTP, and a page that shows them and captures: `realitysim serve`. docs/howto/simulator.md
//! describes the service for its users, docs/howto/page.md the page.
//!
//! [`serve`] listens until it is told to stop, with limits on everything that a client can do. Views are made by a few threads
//! behind a bounded queue: under overload some requests are refused, and the others are answered as fast as before. Changes of
//! the database are noticed while the service runs. [`npy`] writes an array as numpy reads it, and [`LabelledView`] is what the labels of a view are made of. [`PARAMETERS`] lists what a request for a view may state, and [`OPENAPI`]
//! is the document that describes every path.
//!
//! ```rust,no_run
//! use std::collections::BTreeMap;
//! use std::sync::atomic::AtomicBool;
//!
//! use realitysim_config::Settings;
//! use realitysim_service::{ServeError, ServeOptions, serve};
//!
//! let options = ServeOptions {
//!     database: Some("images".into()),
//!     captures: None,
//!     live: None,
//!     listen: ([127, 0, 0, 1], 8765).into(),
//!     token: None,
//!     threads: 2,
//!     settings: Settings::default().views,
//!     lenses: BTreeMap::new(),
//!     scenes: BTreeMap::new(),
//!     max_distance_m: 0.5,
//! };
//! let ready = |address, images| println!("http://{address} serves views of {images} images");
//! serve(options, &AtomicBool::new(false), ready, |change| println!("{change}"))?;
//! # Ok::<(), ServeError>(())
//! ```

mod admission;
mod arrays;
mod batch;
mod captures;
mod connections;
mod encode;
mod guard;
mod labels;
mod live;
mod metrics;
mod page;
mod parameters;
mod response;
mod routes;
mod server;
mod view_service;
mod write_timeout;

pub use arrays::{Values, npy};
pub use labels::LabelledView;
pub use live::LiveRobot;
pub use parameters::PARAMETERS;
pub use server::{ServeError, ServeOptions, serve};

/// The OpenAPI document of the service, as JSON.
pub const OPENAPI: &str = include_str!("openapi.json");

use std::sync::Arc;

use captures::Captures;
use metrics::Metrics;
use response::{HttpProblem, Reply};
use view_service::ViewService;

/// State that all connections share.
struct Service {
    /// `None` if no database is served.
    views: Option<ViewService>,
    captures: Captures,
    live: Option<Arc<dyn LiveRobot>>,
    metrics: Metrics,
    admission: admission::AdmissionControl,
    connections: Arc<connections::Connections>,
}
