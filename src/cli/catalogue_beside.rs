//! Keeps the catalogue beside a folder of captures up to date with what commands do to the captures.

use std::path::PathBuf;

#[cfg(feature = "catalogue")]
use super::output;
#[cfg(feature = "catalogue")]
use crate::catalogue;

/// Adds captures to the catalogue beside their folder, if there is one and it lacks them or has them as they were.
///
/// What comes of it goes to standard error: the command has done what it was called for, and `catalogue show` names what is missing.
#[cfg(feature = "catalogue")]
pub fn update_catalogue(captures: &[PathBuf]) {
    for capture in captures {
        let folder = capture.canonicalize().ok().and_then(|capture| capture.parent().map(PathBuf::from));
        let Some(catalogue) = folder.and_then(|folder| catalogue::catalogue_beside(&folder)) else { continue };
        let mut progress = output::Progress::new("cataloguing");
        let updated =
            catalogue::update(&catalogue, std::slice::from_ref(capture), &mut |done| progress.set(done, None));
        progress.finish();
        match updated {
            Ok(catalogue::Report { sessions: 0, .. }) => {}
            Ok(report) => {
                output::losses(&report.losses);
                report.warnings.iter().for_each(|warning| output::say(warning));
                let rows = report.rows;
                output::say(&format!("{}: has {rows} rows of {} now", catalogue.display(), capture.display()));
            }
            Err(error) => output::say(&format!("{}: not brought up to date: {error}", catalogue.display())),
        }
    }
}

/// Without the feature there is no catalogue to write.
#[cfg(not(feature = "catalogue"))]
pub fn update_catalogue(_captures: &[PathBuf]) {}
