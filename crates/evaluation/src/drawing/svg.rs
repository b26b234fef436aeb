//! Writer of the few SVG elements that charts and maps need. Coordinates are pixels from the left top corner, rounded to
//! hundredths.

use std::fmt::Write;

use glam::DVec2;

/// An SVG document that is being written.
pub(super) struct Svg {
    text: String,
    faded: bool,
}

impl Svg {
    /// Starts a white picture with a title.
    pub(super) fn new(width: f64, height: f64, title: &str) -> Self {
        let mut text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
             font-family=\"'DejaVu Sans', Verdana, sans-serif\">\n<title>{}</title>\n",
            escaped(title)
        );
        text.push_str("<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n");
        Self { text, faded: false }
    }

    /// Returns the text of the document.
    pub(super) fn finish(mut self) -> String {
        self.text.push_str("</svg>\n");
        self.text
    }

    /// Inserts a whole picture at `y` pixels below the top.
    pub(super) fn nest(&mut self, y: f64, picture: &str) {
        self.text.push_str(&picture.replacen("<svg ", &format!("<svg y=\"{y}\" "), 1));
    }

    /// Draws everything until [`Self::unfade`] with this opacity.
    pub(super) fn fade(&mut self, opacity: f64) {
        if opacity < 1.0 {
            self.add(format_args!("<g opacity=\"{opacity}\">"));
            self.faded = true;
        }
    }

    pub(super) fn unfade(&mut self) {
        if self.faded {
            self.add(format_args!("</g>"));
            self.faded = false;
        }
    }

    /// Writes words; `at` is the left end of the baseline.
    pub(super) fn words(&mut self, at: DVec2, size: f64, colour: &str, words: &str) {
        let (x, y) = (round(at.x), round(at.y));
        self.add(format_args!(
            "<text x=\"{x}\" y=\"{y}\" font-size=\"{size}\" fill=\"{colour}\">{}</text>",
            escaped(words)
        ));
    }

    /// Writes words upwards; `at` is the lower end of the baseline.
    pub(super) fn words_upwards(&mut self, at: DVec2, size: f64, colour: &str, words: &str) {
        let (x, y) = (round(at.x), round(at.y));
        self.add(format_args!(
            "<text x=\"{x}\" y=\"{y}\" font-size=\"{size}\" fill=\"{colour}\" transform=\"rotate(-90 {x} {y})\">{}</text>",
            escaped(words)
        ));
    }

    pub(super) fn line(&mut self, from: DVec2, to: DVec2, colour: &str, width: f64, dashes: Option<&str>) {
        self.polyline(&[from, to], colour, width, dashes);
    }

    pub(super) fn polyline(&mut self, points: &[DVec2], colour: &str, width: f64, dashes: Option<&str>) {
        if points.len() < 2 {
            return;
        }
        let dashes = dashes.map_or(String::new(), |dashes| format!(" stroke-dasharray=\"{dashes}\""));
        self.add(format_args!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" stroke-linejoin=\"round\"{dashes}/>",
            list(points)
        ));
    }

    pub(super) fn polygon(&mut self, points: &[DVec2], colour: &str) {
        self.add(format_args!("<polygon points=\"{}\" fill=\"{colour}\"/>", list(points)));
    }

    pub(super) fn disc(&mut self, at: DVec2, radius: f64, colour: &str) {
        let (x, y) = (round(at.x), round(at.y));
        self.add(format_args!("<circle cx=\"{x}\" cy=\"{y}\" r=\"{radius}\" fill=\"{colour}\"/>"));
    }

    pub(super) fn ring(&mut self, at: DVec2, radius: f64, colour: &str, width: f64) {
        let (x, y) = (round(at.x), round(at.y));
        self.add(format_args!(
            "<circle cx=\"{x}\" cy=\"{y}\" r=\"{radius}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\"/>"
        ));
    }

    pub(super) fn rectangle(&mut self, low: DVec2, high: DVec2, colour: &str) {
        let size = high - low;
        let [x, y, width, height] = [low.x, low.y, size.x, size.y].map(round);
        self.add(format_args!(
            "<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" fill=\"none\" stroke=\"{colour}\"/>"
        ));
    }

    fn add(&mut self, element: std::fmt::Arguments) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.text, "{element}");
    }
}

/// Formats points for the attribute `points`.
fn list(points: &[DVec2]) -> String {
    points.iter().map(|point| format!("{},{}", round(point.x), round(point.y))).collect::<Vec<_>>().join(" ")
}

fn round(value: f64) -> f64 {
    libm::round(value * 100.0) / 100.0
}

/// Escapes the characters that have a meaning in XML.
fn escaped(words: &str) -> String {
    words.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
