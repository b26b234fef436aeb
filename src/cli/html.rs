//! Pieces of pages that need no other file.

use std::io::Cursor;

use base64::prelude::{BASE64_STANDARD, Engine};
use image::{ImageFormat, RgbImage};

/// The start of a page with this title, up to its first heading.
pub fn head(title: &str) -> String {
    format!(
        "<!doctype html><html lang=en><head><meta charset=utf-8><meta name=viewport content=\"width=device-width\"><title>{}</title>{STYLE}",
        escaped(title)
    )
}

const STYLE: &str = "<style>\
body{font:16px/1.5 system-ui,sans-serif;margin:0;color:#222;background:#fff}main{max-width:1020px;margin:auto;padding:1em}\
.big{font-size:1.3em}img,svg{max-width:100%;height:auto}table{border-collapse:collapse}td,th{padding:.3em .8em;text-align:left;\
border-bottom:1px solid #8884}figure{margin:1em 0}@media(prefers-color-scheme:dark){body{color:#ddd;background:#181818}}\
</style></head><body><main>";

/// The end of a page.
pub const END: &str = "</main></body></html>";

/// A picture inside of a page.
pub fn embedded(picture: &RgbImage, format: ImageFormat) -> anyhow::Result<String> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format)?;
    Ok(format!(
        "<img alt=\"\" src=\"data:{};base64,{}\">",
        format.to_mime_type(),
        BASE64_STANDARD.encode(bytes.get_ref())
    ))
}

/// Text that stands for itself in a page.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}
