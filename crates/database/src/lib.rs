//! The image database: finds recorded images by the pose of their camera and makes views of them.
//!
//! Images stay where they were recorded, in captures or folders; the database holds an [`Index`] of their poses and a
//! [`Contents`]: their sources. [`add`], [`remove`], [`rebuild`] and [`verify`] maintain it, also while others read it.
//! [`ImageDatabase`] answers requests: it selects images, decodes them, and has [`realitysim_views`] make the view.
//! [`training_set`] prepares images for programs that learn a scene. [`leave_one_out`] measures the quality of the views, [`coverage`] shows the poses that images exist of. The formats of the
//! files are described in docs/reference/formats.md.
//!
//! This example makes a database of one image and asks for the view at that image's pose:
//!
//! ```rust
//! use realitysim_database::{ImageDatabase, TagLimits, ViewQuery, add};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let folder = tempfile::tempdir()?;
//! # let images = folder.path().join("images");
//! # std::fs::create_dir(&images)?;
//! # image::RgbImage::from_pixel(320, 240, image::Rgb([60, 140, 60])).save(images.join("a.png"))?;
//! # let poses = "file,x,y,z,yaw_deg,pitch_deg,roll_deg\na.png,0.1,0.2,0.5,10,20,0\n";
//! # std::fs::write(images.join("poses.csv"), poses)?;
//! # let camera = "image_width: 320\nimage_height: 240\ncamera_matrix: {data: [102.5, 0, 160, 0, 102.5, 120, 0, 0, 1]}\n\
//! #     distortion_model: equidistant\ndistortion_coefficients: {data: [-0.012, 0.003, -0.0008, 0.0]}\n";
//! # std::fs::write(images.join("camera_info.yaml"), camera)?;
//! let db = folder.path().join("db");
//! let field = realitysim_config::load_field("kid-2020")?;
//! // `images` is a folder with poses.csv, camera_info.yaml and the images, or a capture.
//! let added = add(&db, &[images], Some(&field), TagLimits::default(), &mut |_images| ())?;
//! assert_eq!(added.images, 1);
//!
//! let database = ImageDatabase::open(&db, &realitysim_config::ViewsSettings::default())?;
//! let result = database.view(&ViewQuery {
//!     map_from_link: database.index().record(0).pose(),
//!     method: realitysim_views::Method::Exact,
//!     camera: None,
//!     max_distance_m: 0.5,
//!     may_be_stored: true,
//!     without: Vec::new(),
//! })?;
//! assert!(result.stored.is_some(), "the recorded image is the answer");
//! # Ok(())
//! # }
//! ```

mod build;
mod contents;
mod coverage;
mod error;
mod goals;
mod hall;
mod image_circle;
mod image_database;
mod index;
mod input_files;
mod kd_tree;
mod leave_one_out;
mod lit_pixels;
mod masks;
mod moved;
mod parallel;
mod pixels;
mod record;
mod remote_files;
mod source_selection;
mod sources;
pub mod training_set;
mod vignetting;

pub use build::{Added, Checked, Stats, add, rebuild, remove, stats, verify};
pub use contents::{Contents, Source, SourceKind, TagLimits};
pub use coverage::coverage;
pub use error::DatabaseError;
pub use image_database::{ImageDatabase, ViewQuery, ViewResult};
pub use index::{Index, Neighbour, write_index};
pub use kd_tree::Metric;
pub use leave_one_out::leave_one_out;
pub use parallel::in_parallel;
pub use record::Record;
pub use remote_files::{RemoteFiles, set_remote_files};
pub use sources::{FIELD_FILE, POSES_HEAD, SIGMAS_HEAD, ScaledLens, best_tags, covariances, image_quality};
