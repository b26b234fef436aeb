//! The files that YOLO's programs read beside images and labels: which images there are, and what the classes are.

use std::fmt::Write;
use std::path::Path;

use super::super::paths::write;
use super::posed_images::IMAGES;
use crate::database::training_set::is_held_out;

/// Writes `train.txt`, `val.txt` and `data.yaml` for images of these names. `more` are further lines of `data.yaml`.
pub(super) fn write_yolo_set(folder: &Path, files: &[&str], more: &str, names: &[&str]) -> anyhow::Result<()> {
    let list = |held_out: bool| -> String {
        let own = files.iter().enumerate().filter(|(place, _)| is_held_out(*place) == held_out);
        own.map(|(_, file)| format!("./{IMAGES}/{file}\n")).collect()
    };
    write(&folder.join("train.txt"), &list(false))?;
    write(&folder.join("val.txt"), &list(true))?;
    let mut text = format!("# Labels made by `realitysim labels`.\ntrain: train.txt\nval: val.txt\n{more}names:\n");
    names.iter().enumerate().for_each(|(number, name)| _ = writeln!(text, "  {number}: {name}"));
    write(&folder.join("data.yaml"), &text)
}
