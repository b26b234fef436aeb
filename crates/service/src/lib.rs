//! Views over HTTP: `realitysim serve`. docs/service.md is for its users.
//!
//! `Service` holds the database and answers requests; [`serve`] listens, with limits on everything a client can do.
//! Views are made by a few threads behind a bounded queue: over load some requests are refused, and the others are as fast as ever.

mod admission;
mod batch;
mod connections;
mod encode;
mod guard;
mod metrics;
mod parameters;
mod response;
mod routes;
mod server;
mod view_service;
mod write_timeout;

pub use parameters::PARAMETERS;
pub use server::{ServeError, ServeOptions, serve};

/// The OpenAPI document, as it is served.
pub const OPENAPI: &str = include_str!("openapi.json");

use std::sync::Arc;

use metrics::Metrics;
use response::{HttpProblem, Reply};
use view_service::ViewService;

/// What all connections share.
struct Service {
    stock: ViewService,
    metrics: Metrics,
    door: admission::AdmissionControl,
    connections: Arc<connections::Connections>,
}
