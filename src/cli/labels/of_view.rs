//! Labels of a view, as `realitysim labels --format png` writes those of recorded images.

use std::path::Path;

use anyhow::Context;

use super::super::export::frames::fill_own_folder;
use super::super::paths::make_folder;
use super::png_form::{FOLDERS, PngForm};
use super::posed_images::IMAGES;
use super::preview::{preview, sheet};
use crate::database::{ImageDatabase, ViewResult};
use crate::service::LabelledView;

/// Writes a view and its labels into a folder of its own. `file` is the name of the view's picture, which `save` writes, and `figures_m` are
/// the distances of figures that were drawn into it, infinite where there is none; it may be empty.
pub fn label_view(
    folder: &Path,
    file: &str,
    database: &ImageDatabase,
    shown: &ViewResult,
    figures_m: &[f32],
    save: impl FnOnce(&Path) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    fill_own_folder(folder, || {
        let view = LabelledView::new(database, shown, figures_m);
        [IMAGES].iter().chain(&FOLDERS).try_for_each(|name| make_folder(&folder.join(name)))?;
        save(&folder.join(IMAGES).join(file))?;
        let (labeller, posed) = (view.labeller(), view.posed_image());
        let classes = labeller.classes(&posed);
        let form = PngForm { folder, labeller, world: database.world() };
        let rows = form.write_image(file, &posed, &classes)?;
        form.write_tables([&rows].into_iter())?;
        let looked_at = preview(labeller, &posed, &shown.answer.image, &classes);
        let path = folder.join("preview.jpg");
        sheet(&[(looked_at, file.to_owned())]).save(&path).with_context(|| path.display().to_string())
    })
}
