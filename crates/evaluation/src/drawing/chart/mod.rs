//! Charts as SVG: curves, clouds of points and limits over two axes, each linear or logarithmic.
//!
//! Words are measured in DejaVu Sans. Where that font is missing, Verdana, which is about as wide, replaces it.

mod axis;
mod labels;

use glam::DVec2;

use super::svg::Svg;
use super::text;
use axis::Span;
pub use axis::{Axis, Scale};
use labels::LabelLayout;

/// Width of a chart, pixels. All charts have one size, since they stand below each other in documents.
const WIDTH: f64 = 900.0;
/// Height of a chart, pixels.
const HEIGHT: f64 = 560.0;
/// Margins around the data, pixels.
const LEFT: f64 = 74.0;
const RIGHT: f64 = 22.0;
const BOTTOM: f64 = 62.0;
/// Size of the title, pixels.
const TITLE: f64 = 17.0;
/// Size of other words, pixels.
const WORDS: f64 = 13.0;
const MARK_RADIUS: f64 = 4.5;
/// Length of a line in the legend, pixels.
const SAMPLE: f64 = 30.0;

const INK: &str = "#37393c";
const GRID: &str = "#e3e6e8";
const FRAME: &str = "#8a9095";

/// A chart.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Title above the chart.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Data; later layers lie on top.
    pub layers: Vec<Layer>,
    /// Limits.
    pub rules: Vec<Rule>,
    /// Words beside points.
    pub notes: Vec<Note>,
}

/// Points that belong together.
///
/// Those that an axis cannot show (NaN, or not above 0 on a logarithmic axis) are left out.
#[derive(Clone, Debug)]
pub struct Layer {
    /// Name in the legend; `None` leaves the layer out of it.
    pub name: Option<String>,
    /// Colour as SVG writes it.
    pub colour: &'static str,
    /// Mark at each point.
    pub mark: Option<Mark>,
    /// Line through the points.
    pub line: Option<Line>,
    /// Opacity, 0 to 1.
    pub opacity: f64,
    /// Points in units of the axes.
    pub points: Vec<DVec2>,
}

/// Shape of a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// Filled circle.
    Disc,
    /// Circle.
    Ring,
    /// Filled square.
    Square,
    /// Filled square on its corner.
    Diamond,
    /// Circle of twice the size, for a single point that stands out.
    Target,
}

/// Style of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// Continuous line.
    Solid,
    /// Dashed line.
    Dashed,
}

/// A limit, drawn as a line across the whole chart.
#[derive(Clone, Debug)]
pub struct Rule {
    /// Axis that the limit is a value of.
    pub across: Across,
    /// Value of the limit.
    pub at: f64,
    /// Name beside the line.
    pub name: String,
}

/// Axis of a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Across {
    /// Horizontal axis: the line is vertical.
    X,
    /// Vertical axis: the line is horizontal.
    Y,
}

/// Words beside a point.
#[derive(Clone, Debug)]
pub struct Note {
    /// The point, in units of the axes.
    pub at: DVec2,
    /// The words.
    pub words: String,
}

/// The part of the sheet that shows the data.
struct Frame {
    x: Span,
    y: Span,
    top: f64,
}

impl Frame {
    /// Returns the pixel of a point; `None` if an axis cannot show it.
    fn place(&self, point: DVec2) -> Option<DVec2> {
        let (x, y) = (self.x.share(point.x)?, self.y.share(point.y)?);
        Some(DVec2::new(LEFT + x * self.width(), self.bottom() - y * (self.bottom() - self.top)))
    }

    /// Returns the width of words, pixels.
    fn width(&self) -> f64 {
        WIDTH - LEFT - RIGHT
    }

    fn bottom(&self) -> f64 {
        HEIGHT - BOTTOM
    }
}

impl Chart {
    /// Returns charts below each other as one SVG.
    pub fn stacked(charts: &[Self]) -> String {
        let title = charts.first().map_or("", |chart| &chart.title);
        let mut svg = Svg::new(WIDTH, HEIGHT * charts.len() as f64, title);
        for (index, chart) in charts.iter().enumerate() {
            svg.nest(HEIGHT * index as f64, &chart.to_svg());
        }
        svg.finish()
    }

    /// Returns the chart as SVG.
    pub fn to_svg(&self) -> String {
        let mut svg = Svg::new(WIDTH, HEIGHT, &self.title);
        svg.words(DVec2::new(LEFT, 26.0), TITLE, INK, &self.title);
        let top = self.draw_legend(&mut svg) + 14.0;
        let along = |across: Across| {
            let of = move |point: &DVec2| if across == Across::X { point.x } else { point.y };
            let points = self.layers.iter().flat_map(|layer| &layer.points).map(of);
            points.chain(self.rules.iter().filter(move |rule| rule.across == across).map(|rule| rule.at))
        };
        let frame =
            Frame { x: Span::of(self.x.scale, along(Across::X)), y: Span::of(self.y.scale, along(Across::Y)), top };
        self.draw_axes(&mut svg, &frame);
        let mut taken = LabelLayout::within(DVec2::new(LEFT, top), DVec2::new(WIDTH - RIGHT, frame.bottom()));
        for rule in &self.rules {
            draw_rule(&mut svg, &frame, rule, &mut taken);
        }
        for layer in &self.layers {
            draw_layer(&mut svg, &frame, layer, &mut taken);
        }
        for note in &self.notes {
            let Some(at) = frame.place(note.at) else { continue };
            let (corner, leader) = taken.place_label(at, DVec2::new(width(&note.words), WORDS));
            if leader {
                let end = corner + DVec2::new(if corner.x > at.x { -2.0 } else { width(&note.words) }, -4.0);
                svg.line(at, end, FRAME, 0.7, None);
            }
            svg.words(corner, WORDS, INK, &note.words);
        }
        svg.finish()
    }

    /// Draws the legend in as many rows as it takes, and returns where it ends, pixels from the top.
    fn draw_legend(&self, svg: &mut Svg) -> f64 {
        let (mut at, mut any) = (DVec2::new(LEFT, 50.0), false);
        for layer in &self.layers {
            let Some(name) = &layer.name else { continue };
            let sample = if layer.line.is_some() { SAMPLE } else { 4.0 * MARK_RADIUS };
            let width = sample + 6.0 + width(name) + 20.0;
            if any && at.x + width > WIDTH - RIGHT {
                at = DVec2::new(LEFT, at.y + 20.0);
            }
            any = true;
            let middle = at + DVec2::new(sample / 2.0, -4.5);
            svg.fade(layer.opacity);
            if let Some(line) = layer.line {
                let half = DVec2::new(sample / 2.0, 0.0);
                svg.line(middle - half, middle + half, layer.colour, 2.0, dashes(line));
            }
            if let Some(mark) = layer.mark {
                draw_mark(svg, middle, mark, layer.colour);
            }
            svg.unfade();
            svg.words(at + DVec2::new(sample + 6.0, 0.0), WORDS, INK, name);
            at.x += width;
        }
        if any { at.y } else { 30.0 }
    }

    fn draw_axes(&self, svg: &mut Svg, frame: &Frame) {
        let (left, right, top, bottom) = (LEFT, LEFT + frame.width(), frame.top, frame.bottom());
        let mut free_from = f64::NEG_INFINITY;
        for tick in frame.x.ticks() {
            let Some(share) = frame.x.share(tick.value) else { continue };
            let x = left + share * frame.width();
            svg.line(DVec2::new(x, top), DVec2::new(x, bottom), GRID, 1.0, None);
            let half = width(&tick.number) / 2.0;
            if !tick.number.is_empty() && x - half > free_from {
                svg.words(DVec2::new(x - half, bottom + 18.0), WORDS, INK, &tick.number);
                free_from = x + half + 6.0;
            }
        }
        let mut free_below = f64::INFINITY;
        for tick in frame.y.ticks() {
            let Some(share) = frame.y.share(tick.value) else { continue };
            let y = bottom - share * (bottom - top);
            svg.line(DVec2::new(left, y), DVec2::new(right, y), GRID, 1.0, None);
            if !tick.number.is_empty() && y + WORDS / 2.0 < free_below {
                let width = width(&tick.number);
                svg.words(DVec2::new(left - 8.0 - width, y + 4.5), WORDS, INK, &tick.number);
                free_below = y - WORDS / 2.0 - 2.0;
            }
        }
        svg.rectangle(DVec2::new(left, top), DVec2::new(right, bottom), FRAME);
        let middle = DVec2::new((left + right) / 2.0, (top + bottom) / 2.0);
        let half = width(&self.x.label) / 2.0;
        svg.words(DVec2::new(middle.x - half, HEIGHT - 16.0), WORDS, INK, &self.x.label);
        let half = width(&self.y.label) / 2.0;
        svg.words_upwards(DVec2::new(20.0, middle.y + half), WORDS, INK, &self.y.label);
    }
}

fn draw_rule(svg: &mut Svg, frame: &Frame, rule: &Rule, taken: &mut LabelLayout) {
    const RULE: &str = "#b3261e";
    let (right, bottom) = (LEFT + frame.width(), frame.bottom());
    let width = width(&rule.name);
    match rule.across {
        Across::X => {
            let Some(share) = frame.x.share(rule.at) else { return };
            let x = LEFT + share * frame.width();
            svg.line(DVec2::new(x, frame.top), DVec2::new(x, bottom), RULE, 1.5, dashes(Line::Dashed));
            let x = if x + 6.0 + width > right { x - 6.0 - width } else { x + 6.0 };
            let at = DVec2::new(x, frame.top + 18.0);
            svg.words(at, WORDS, RULE, &rule.name);
            taken.occupy(at, DVec2::new(width, WORDS));
        }
        Across::Y => {
            let Some(share) = frame.y.share(rule.at) else { return };
            let y = bottom - share * (bottom - frame.top);
            svg.line(DVec2::new(LEFT, y), DVec2::new(right, y), RULE, 1.5, dashes(Line::Dashed));
            let at = DVec2::new(right - 6.0 - width, if y - 20.0 < frame.top { y + 16.0 } else { y - 6.0 });
            svg.words(at, WORDS, RULE, &rule.name);
            taken.occupy(at, DVec2::new(width, WORDS));
        }
    }
}

fn draw_layer(svg: &mut Svg, frame: &Frame, layer: &Layer, taken: &mut LabelLayout) {
    let places: Vec<DVec2> = layer.points.iter().filter_map(|point| frame.place(*point)).collect();
    svg.fade(layer.opacity);
    if let Some(line) = layer.line {
        svg.polyline(&places, layer.colour, 2.0, dashes(line));
        // Words across a curve are hard to read: places along it are taken.
        for pair in places.windows(2) {
            for step in 1..8 {
                let at = pair[0].lerp(pair[1], f64::from(step) / 8.0);
                taken.occupy(at + DVec2::new(-1.0, 1.0), DVec2::splat(2.0));
            }
        }
    }
    if let Some(mark) = layer.mark {
        for place in &places {
            draw_mark(svg, *place, mark, layer.colour);
            // Faded marks are a background that words may cover.
            if layer.opacity > 0.5 {
                let half = DVec2::splat(MARK_RADIUS);
                taken.occupy(*place + DVec2::new(-half.x, half.y), 2.0 * half);
            }
        }
    }
    svg.unfade();
}

fn draw_mark(svg: &mut Svg, at: DVec2, mark: Mark, colour: &str) {
    let r = MARK_RADIUS;
    match mark {
        Mark::Disc => svg.disc(at, r, colour),
        Mark::Ring => svg.ring(at, r, colour, 1.6),
        Mark::Target => svg.ring(at, 2.0 * r, colour, 2.2),
        Mark::Square => {
            svg.polygon(&[(-r, -r), (r, -r), (r, r), (-r, r)].map(|offset| at + DVec2::from(offset)), colour)
        }
        Mark::Diamond => {
            let r = 1.3 * r;
            svg.polygon(&[(0.0, -r), (r, 0.0), (0.0, r), (-r, 0.0)].map(|offset| at + DVec2::from(offset)), colour);
        }
    }
}

fn width(words: &str) -> f64 {
    // Pictures state the size of text as the height of the font, SVG as its em.
    const HEIGHT_OF_EM: f64 = 1.164;
    text::width(HEIGHT_OF_EM * WORDS, words)
}

fn dashes(line: Line) -> Option<&'static str> {
    match line {
        Line::Solid => None,
        Line::Dashed => Some("6 4"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<DVec2>) -> Chart {
        let axis = |label: &str| Axis { label: label.to_owned(), scale: Scale::Logarithmic };
        let layer = |mark| Layer {
            name: Some("a < b & \"c\"".to_owned()),
            colour: "#123456",
            mark: Some(mark),
            line: Some(Line::Solid),
            opacity: 0.4,
            points: points.clone(),
        };
        let marks = [Mark::Disc, Mark::Ring, Mark::Square, Mark::Diamond, Mark::Target];
        Chart {
            title: "t".to_owned(),
            x: axis("x"),
            y: axis("y"),
            layers: marks.map(layer).to_vec(),
            rules: vec![Rule { across: Across::X, at: 8.0, name: "8 ms".to_owned() }],
            notes: points.iter().map(|at| Note { at: *at, words: "note".to_owned() }).collect(),
        }
    }

    #[test]
    fn words_are_escaped_and_all_points_drawn() {
        let svg = chart(vec![DVec2::new(1.0, 2.0), DVec2::new(10.0, 0.5)]).to_svg();
        assert!(svg.starts_with("<svg") && svg.ends_with("</svg>\n"));
        assert!(svg.contains("a &lt; b &amp; &quot;c&quot;") && !svg.contains("a < b"));
        // Each layer with circles has one in the legend and two at its points.
        assert_eq!(svg.matches("<circle").count(), 3 * 3);
        assert_eq!(svg.matches(">note</text>").count(), 2);
    }

    #[test]
    fn what_cannot_be_shown_is_left_out() {
        for odd in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
            let svg = chart(vec![DVec2::new(odd, 1.0), DVec2::new(1.0, odd), DVec2::new(2.0, 2.0)]).to_svg();
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{odd}");
            assert_eq!(svg.matches(">note</text>").count(), 1, "{odd}");
        }
        assert!(chart(Vec::new()).to_svg().contains("8 ms"));
    }

    #[test]
    fn words_stay_on_the_sheet() {
        let corners = [0.1, 1.0, 10.0, 100.0].map(|x| DVec2::new(x, x));
        let crowd: Vec<DVec2> = (0..20).map(|i| DVec2::new(100.0 - f64::from(i) * 0.1, 100.0)).chain(corners).collect();
        let svg = chart(crowd).to_svg();
        for text in svg.split("<text ").skip(1) {
            let number = |key: &str| -> f64 {
                let start = text.find(&format!("{key}=\"")).expect("a key") + key.len() + 2;
                text[start..].split('"').next().expect("a value").parse().expect("a number")
            };
            let (x, y) = (number("x"), number("y"));
            assert!((0.0..=WIDTH).contains(&x) && (0.0..=HEIGHT).contains(&y), "{text}");
        }
    }
}
