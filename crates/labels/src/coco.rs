//! COCO's JSON: <https://cocodataset.org/#format-data>.
//!
//! Categories are the classes of pixels, whose segmentations are run lengths, the kinds of landmarks, whose annotations are boxes, and
//! `field`, whose keypoints are all landmarks. Regions to be ignored are annotations of the category `ignore` with `iscrowd`.

use glam::DVec2;
use serde_json::{Value, json};

use crate::{Class, Keypoint, LANDMARK_CLASSES, Labeller, PosedImage, SphereBox, Visibility};

/// The annotations of many images, as they come in.
#[derive(Clone, Debug)]
pub struct Coco {
    categories: Value,
    images: Vec<String>,
    annotations: Vec<String>,
}

/// The annotations of one image.
#[derive(Clone, Debug)]
pub struct CocoImage {
    id: usize,
    image: String,
    annotations: Vec<String>,
}

/// More annotations than an image has: numbers of annotations begin anew at multiples of it.
const ANNOTATION_STRIDE: usize = 1000;
/// Number of the category of regions to be ignored.
const IGNORE: usize = 7;
/// Number of the category of a whole field with its keypoints.
const FIELD: usize = 20;
/// Number of the first category of landmarks.
const FIRST_LANDMARK: usize = 10;
/// Number of the only category of [`Coco::of_one_class`].
const ONE_CLASS: usize = 1;

impl Coco {
    /// No annotations yet, of a labeller's field.
    pub fn new(labeller: &Labeller) -> Self {
        let class =
            |class: &Class| json!({"id": *class as usize + 1, "name": class.name(), "supercategory": "surface"});
        let landmark =
            |(at, name): (usize, &&str)| json!({"id": FIRST_LANDMARK + at, "name": name, "supercategory": "landmark"});
        let names: Vec<&str> = labeller.landmarks().iter().map(|landmark| landmark.name.as_str()).collect();
        let others = [
            json!({"id": IGNORE, "name": "ignore", "supercategory": "surface"}),
            json!({"id": FIELD, "name": "field", "supercategory": "field", "keypoints": names, "skeleton": []}),
        ];
        let landmarks = LANDMARK_CLASSES.names.iter().enumerate().map(landmark);
        let categories = Class::KNOWN.iter().map(class).chain(landmarks).chain(others).collect();
        Self { categories, images: Vec::new(), annotations: Vec::new() }
    }

    /// No annotations yet, of boxes of a single class, which has the number 1.
    pub fn of_one_class(name: &str) -> Self {
        let categories = json!([{"id": ONE_CLASS, "name": name, "supercategory": "object"}]);
        Self { categories, images: Vec::new(), annotations: Vec::new() }
    }

    /// Adds the annotations of an image.
    pub fn push(&mut self, image: CocoImage) {
        self.images.push(image.image);
        self.annotations.extend(image.annotations);
    }

    /// The file's text.
    pub fn text(&self) -> String {
        let (images, annotations) = (self.images.join(",\n"), self.annotations.join(",\n"));
        format!("{{\"categories\": {},\n\"images\": [{images}],\n\"annotations\": [{annotations}]}}\n", self.categories)
    }
}

impl CocoImage {
    /// The annotations of an image. `id` is its number in the file, from 1 on, `file` its name.
    pub fn new(labeller: &Labeller, image: &PosedImage, classes: &[Class], id: usize, file: &str) -> Self {
        let [width, height] = [image.camera.width(), image.camera.height()];
        let mut own = Self::empty(image, id, file);
        let regions = Regions::of(classes, [width, height]);
        let known = Class::KNOWN.iter().map(|class| (*class as usize + 1, *class));
        for (category, class) in known.chain([(IGNORE, Class::Ignore)]) {
            if let Some(region) = regions.region(class) {
                own.annotate(category, region, json!({"iscrowd": u8::from(class == Class::Ignore)}));
            }
        }
        for found in labeller.boxes(image) {
            if let Some(place) = LANDMARK_CLASSES.class(found.kind) {
                let more = json!({"iscrowd": 0, "hidden_share": rounded(found.hidden_share)});
                own.annotate(FIRST_LANDMARK + place, of_box(found.from, found.to), more);
            }
        }
        let keypoints = labeller.keypoints(image);
        let inside: Vec<&Keypoint> =
            keypoints.iter().filter(|keypoint| keypoint.visibility != Visibility::Outside).collect();
        if let Some(around) = around(&inside) {
            let numbers: Vec<f64> = keypoints.iter().flat_map(triple).collect();
            let sigmas: Vec<f64> = keypoints.iter().map(|keypoint| rounded(keypoint.sigma_px)).collect();
            let more = json!({"iscrowd": 0, "keypoints": numbers, "num_keypoints": inside.len(), "sigmas_px": sigmas});
            own.annotate(FIELD, around, more);
        }
        own
    }

    /// An image with the box of a sphere, for [`Coco::of_one_class`].
    pub fn of_sphere(found: &SphereBox, image: &PosedImage, id: usize, file: &str) -> Self {
        let mut own = Self::empty(image, id, file);
        let more = json!({"iscrowd": 0, "hidden_share": rounded(1.0 - found.shown_share), "sigma_px": rounded(found.sigma_px)});
        own.annotate(ONE_CLASS, of_box(found.from, found.to), more);
        own
    }

    fn empty(image: &PosedImage, id: usize, file: &str) -> Self {
        let [width, height] = [image.camera.width(), image.camera.height()];
        let head = json!({"id": id, "file_name": file, "width": width, "height": height}).to_string();
        Self { id, image: head, annotations: Vec::new() }
    }

    /// Adds an annotation, made of the keys of both objects.
    fn annotate(&mut self, category: usize, place: Value, more: Value) {
        let id = ANNOTATION_STRIDE * self.id + self.annotations.len();
        let mut annotation = json!({"id": id, "image_id": self.id, "category_id": category});
        if let Some(object) = annotation.as_object_mut() {
            let parts = [place, more].into_iter().filter_map(|part| part.as_object().cloned());
            object.extend(parts.flatten());
        }
        self.annotations.push(annotation.to_string());
    }
}

/// The pixels of each class as runs that go down the columns, one column after another.
struct Regions {
    size: [usize; 2],
    /// For each class by its number: first pixel and end of each run, in the order of the columns.
    runs: Vec<Vec<[usize; 2]>>,
}

impl Regions {
    fn of(classes: &[Class], [width, height]: [usize; 2]) -> Self {
        let mut runs = vec![Vec::new(); 1 + usize::from(u8::MAX)];
        let (mut first, mut last) = (0, None);
        for u in 0..width {
            for v in 0..height {
                let (class, at) = (classes[v * width + u], u * height + v);
                if last != Some(class) {
                    if let Some(last) = last {
                        runs[last as usize].push([first, at]);
                    }
                    (first, last) = (at, Some(class));
                }
            }
        }
        if let Some(last) = last {
            runs[last as usize].push([first, width * height]);
        }
        Self { size: [width, height], runs }
    }

    /// Area, box and run lengths of a class; `None` if no pixel has it. The first run length is that of other classes.
    fn region(&self, class: Class) -> Option<Value> {
        let [width, height] = self.size;
        let runs = &self.runs[class as usize];
        let (mut counts, mut end, mut area) = (Vec::with_capacity(2 * runs.len() + 1), 0, 0);
        let (mut low, mut high) = ([width, height], [0, 0]);
        for [from, to] in runs {
            counts.extend([from - end, to - from]);
            (end, area) = (*to, area + to - from);
            let (columns, rows) = ([from / height, (to - 1) / height], [from % height, (to - 1) % height]);
            // A run over the end of a column reaches from the image's bottom to its top.
            let rows = if columns[0] == columns[1] { rows } else { [0, height - 1] };
            low = [low[0].min(columns[0]), low[1].min(rows[0])];
            high = [high[0].max(columns[1] + 1), high[1].max(rows[1] + 1)];
        }
        if end < width * height {
            counts.push(width * height - end);
        }
        let place = || [low[0], low[1], high[0] - low[0], high[1] - low[1]];
        (area > 0).then(
            || json!({"area": area, "bbox": place(), "segmentation": {"size": [height, width], "counts": counts}}),
        )
    }
}

fn of_box(from: DVec2, to: DVec2) -> Value {
    let size = to - from;
    let corners = [from, DVec2::new(to.x, from.y), to, DVec2::new(from.x, to.y)];
    let outline: Vec<f64> = corners.iter().flat_map(|corner| [rounded(corner.x), rounded(corner.y)]).collect();
    let place = [from.x, from.y, size.x, size.y].map(rounded);
    json!({"area": rounded(size.x * size.y), "bbox": place, "segmentation": [outline]})
}

/// Box and area around keypoints; `None` without any.
fn around(keypoints: &[&Keypoint]) -> Option<Value> {
    let from = keypoints.iter().map(|keypoint| keypoint.at).reduce(DVec2::min)? + 0.5;
    let to = keypoints.iter().map(|keypoint| keypoint.at).reduce(DVec2::max)? + 0.5;
    let size = to - from;
    let place = [from.x, from.y, size.x, size.y].map(rounded);
    Some(json!({"area": rounded(size.x * size.y), "bbox": place, "segmentation": []}))
}

/// x, y and visibility: 0 outside, 1 hidden, 2 visible. The first pixel's centre is (0.5, 0.5).
fn triple(keypoint: &Keypoint) -> [f64; 3] {
    match keypoint.visibility {
        Visibility::Outside => [0.0; 3],
        Visibility::Hidden => [rounded(keypoint.at.x + 0.5), rounded(keypoint.at.y + 0.5), 1.0],
        Visibility::Visible => [rounded(keypoint.at.x + 0.5), rounded(keypoint.at.y + 0.5), 2.0],
    }
}

/// Thousandths of a pixel are enough.
fn rounded(value: f64) -> f64 {
    libm::round(value * 1e3) / 1e3
}
