//! The page: static files inside the program, which a browser puts together.
//!
//! They hold nothing of the database and are therefore sent to clients without a token as well; the page asks for it.

use hyper::StatusCode;
use hyper::header::{CACHE_CONTROL, HeaderName, HeaderValue};

use super::Reply;
use super::response::bytes;

/// A file of the page.
pub(super) struct PageFile {
    path: &'static str,
    media_type: &'static str,
    content: &'static str,
}

const HTML: &str = "text/html; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const PICTURE: &str = "image/svg+xml";

macro_rules! file {
    ($path:literal, $name:literal, $media_type:expr) => {
        PageFile { path: $path, media_type: $media_type, content: include_str!(concat!("../page/", $name)) }
    };
}

/// The files of the page.
const FILES: [PageFile; 15] = [
    file!("/", "index.html", HTML),
    file!("/page/style.css", "style.css", STYLE),
    file!("/page/icon.svg", "icon.svg", PICTURE),
    file!("/page/main.js", "main.js", SCRIPT),
    file!("/page/api.js", "api.js", SCRIPT),
    file!("/page/field.js", "field.js", SCRIPT),
    file!("/page/arrays.js", "arrays.js", SCRIPT),
    file!("/page/pose.js", "pose.js", SCRIPT),
    file!("/page/walk.js", "walk.js", SCRIPT),
    file!("/page/link.js", "link.js", SCRIPT),
    file!("/page/views.js", "views.js", SCRIPT),
    file!("/page/evidence.js", "evidence.js", SCRIPT),
    file!("/page/captures.js", "captures.js", SCRIPT),
    file!("/page/live.js", "live.js", SCRIPT),
    file!("/page/charts.js", "charts.js", SCRIPT),
];

/// What a browser may do with the page: nothing is loaded from elsewhere, no script or style stands in the document, nobody frames it.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Finds the file of the page at a path.
pub(super) fn page_file(path: &str) -> Option<&'static PageFile> {
    FILES.iter().find(|file| file.path == path)
}

impl PageFile {
    /// Returns the file as a reply.
    pub(super) fn reply(&self) -> Reply {
        let mut reply = bytes(StatusCode::OK, self.media_type, self.content);
        let headers = reply.headers_mut();
        headers.insert(HeaderName::from_static("content-security-policy"), HeaderValue::from_static(POLICY));
        headers.insert(HeaderName::from_static("referrer-policy"), HeaderValue::from_static("no-referrer"));
        // A new version of the program has other files under the same names.
        headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-cache"));
        reply
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_that_the_page_names_is_there_and_none_is_elsewhere() {
        for file in FILES {
            assert!(
                !file.content.contains("http://") && !file.content.contains("https://") || file.media_type == PICTURE,
                "{}",
                file.path
            );
            for quoted in
                file.content.split(['"', '\'']).filter(|text| text.starts_with("/page/") || text.starts_with("./"))
            {
                let path = quoted.replace("./", "/page/");
                assert!(page_file(&path).is_some(), "{} names {quoted}", file.path);
            }
        }
    }

    #[test]
    fn the_document_has_no_script_and_no_style_of_its_own() {
        let document = page_file("/").expect("the document").content;
        for inline in [" onclick", " style=", "<style", "javascript:"] {
            assert!(!document.contains(inline), "{inline}");
        }
        assert!(document.split("<script").skip(1).all(|script| script.contains("src=")));
    }
}
