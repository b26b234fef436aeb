//! Asks a detector about all images, and holds its answers against the truth.

use core::cmp::Ordering;
use std::path::Path;

use anyhow::{Context, bail};
use tempfile::TempDir;

use super::super::super::detector::Detector;
use super::super::super::marks::rgb;
use super::super::super::output;
use super::super::super::paths::{save, temporary};
use super::super::posed_images::PosedImages;
use crate::database::Record;
use crate::labels::{ClassList, Comparison, Labeller, parse_detections};
use crate::recording::Loss;

/// A detector, and what is the same for all images.
pub(super) struct Asking<'a> {
    pub(super) images: &'a PosedImages<'a>,
    pub(super) labeller: &'a Labeller,
    pub(super) classes: ClassList,
    pub(super) command: &'a str,
    pub(super) within_px: f64,
}

/// An image that the detector has answered for.
pub(super) struct Judged {
    /// Its number in the database.
    pub(super) number: usize,
    pub(super) record: Record,
    /// Disagreements, the surest first.
    pub(super) compared: Comparison,
}

/// The answers for all images.
#[derive(Default)]
pub(super) struct Answers {
    pub(super) judged: Vec<Judged>,
    /// Why there is no answer: pictures and reasons.
    pub(super) failed: Vec<String>,
}

/// A detector that fails for so many images from the first on is not asked again: each may take a minute.
const MAX_FAILED_FIRST: usize = 5;
/// Failures that are named; more are counted.
const NAMED: usize = 10;

impl Asking<'_> {
    /// Asks about all images, one after the other.
    pub(super) fn ask_all(&self, chosen: &[(usize, Record)]) -> anyhow::Result<Answers> {
        let folder = temporary()?;
        let mut detector = Detector::new(self.command);
        let mut progress = output::Progress::new("asking");
        let mut answers = Answers::default();
        for (done, (number, record)) in chosen.iter().enumerate() {
            progress.set(done as u64, Some(chosen.len() as u64));
            match self.ask(&mut detector, &folder, *number, record) {
                Ok(compared) => answers.judged.push(Judged { number: *number, record: *record, compared }),
                Err(why) => answers.failed.push(format!("{number:06}.png: {why:#}")),
            }
            if answers.judged.is_empty() && answers.failed.len() == MAX_FAILED_FIRST {
                break;
            }
        }
        progress.finish();
        if answers.judged.is_empty() {
            let first = answers.failed.first().map_or("", String::as_str);
            bail!("the detector failed for each of {} images: {first}", answers.failed.len());
        }
        Ok(answers)
    }

    fn ask(
        &self,
        detector: &mut Detector,
        folder: &TempDir,
        number: usize,
        record: &Record,
    ) -> anyhow::Result<Comparison> {
        let image = self.images.database().image(number).map_err(anyhow::Error::msg)?;
        let picture = folder.path().join(format!("{number:06}.png"));
        save(&rgb(image.full())?, &picture)?;
        let answer = detector.ask(&picture);
        let _ = std::fs::remove_file(&picture);
        let found = parse_detections(&answer?, self.classes);
        let found = found.with_context(|| format!("--detector {:?} printed", self.command))?;
        let shown = image.full().mask();
        let posed = self.images.posed(record, &shown).map_err(anyhow::Error::msg)?;
        let mut compared = self.labeller.compare(&posed, self.classes, &found, self.within_px);
        compared.disagreements.sort_by(|a, b| b.certainty.total_cmp(&a.certainty));
        Ok(compared)
    }
}

impl Judged {
    /// Certainty of the surest disagreement.
    pub(super) fn certainty(&self) -> f64 {
        self.compared.disagreements.first().map_or(0.0, |found| found.certainty)
    }

    /// The order of images: by the surest disagreement, of equally sure ones by all of them.
    pub(super) fn surest_first(&self, other: &Self) -> Ordering {
        let sum = |judged: &Self| judged.compared.disagreements.iter().map(|found| found.certainty).sum::<f64>();
        let by_surest = other.certainty().total_cmp(&self.certainty());
        by_surest.then(sum(other).total_cmp(&sum(self))).then(self.number.cmp(&other.number))
    }
}

impl Answers {
    /// The images without an answer as losses.
    pub(super) fn losses(&self, folder: &Path) -> Vec<Loss> {
        let mut losses: Vec<Loss> = self.failed.iter().take(NAMED).map(|why| Loss::new(folder, why.clone())).collect();
        if let Some(more) = self.failed.len().checked_sub(NAMED).filter(|more| *more > 0) {
            losses.push(Loss::new(folder, format!("the detector failed for {more} more images")));
        }
        losses
    }
}
