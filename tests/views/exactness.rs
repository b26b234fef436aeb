//! The map is exact: from any lens to any lens, for any two poses.

use glam::{DVec2, DVec3};
use proptest::prelude::*;
use realitysim::geometry::{Euler, Isometry, Lens, LensModel, LensParameters};
use realitysim::views::{
    Camera, Candidate, Method, NOTHING, Provenance, Pyramid, Raster, SURE, Surface, Target, UNSURE, ViewError,
    ViewSettings, Warp, World, view,
};

use super::{candidate, field, lens, pose, request};

fn lens_of(model: LensModel, fov_deg: Option<f64>) -> Camera {
    let parameters =
        LensParameters { width: 320, height: 240, fx: 110.0, fy: 108.0, cx: 158.0, cy: 121.0, model, fov_deg };
    Camera::new(&Lens::new(parameters).expect("a lens"))
}

fn gray(camera: &Camera) -> Pyramid {
    let count = camera.width() * camera.height();
    Pyramid::new(Raster::from_rgb(camera.width(), camera.height(), &vec![99; 3 * count], camera.shows()).expect("fits"))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn a_place_of_the_ground_is_read_where_the_source_draws_it(
        models in (0..4usize, 0..4usize), dx in -0.5..0.5f64, dy in -0.5..0.5f64, dz in -0.2..0.3f64, yaw in -40.0..40.0f64,
        tilt in -0.2..0.2f64,
    ) {
        let model = |which: usize| match which {
            0 => lens_of(LensModel::KannalaBrandt { k: [0.0; 4] }, Some(180.0)),
            1 => lens_of(LensModel::KannalaBrandt { k: [-0.02, 0.004, -0.0015, 0.0002] }, Some(170.0)),
            2 => lens_of(LensModel::Equisolid, Some(180.0)),
            _ => lens_of(LensModel::PlumbBob { d: [-0.2, 0.05, 0.001, -0.001, 0.0] }, None),
        };
        let (camera, other, world) = (model(models.0), model(models.1), World::without_goals(&field()));
        let (wanted, image) = (pose(0.3, -0.2, 20.0), gray(&other));
        let euler = Euler { yaw: yaw.to_radians(), pitch: 0.5 + tilt, roll: tilt };
        let place = Isometry::from_euler(euler, DVec3::new(0.3 + dx, -0.2 + dy, 0.55 + dz));
        let source = candidate(&other, place, &image);
        let target = Target::new(&camera, &wanted, &world);
        let warp = Warp::new(&target, &source);
        let optical = |pose: &Isometry| *pose * Isometry::link_from_optical();
        let (mut off, mut compared) = (Vec::new(), 0);
        for (u, v) in (0..240).step_by(3).flat_map(|v| (0..320).step_by(3).map(move |u| (u, v))) {
            let Some((found, Surface::Ground)) = warp.pixel(u, v) else { continue };
            // By the lenses themselves, without any of the map's short cuts.
            let ray = optical(&wanted).transform_vector(camera.lens().unproject(DVec2::new(u as f64, v as f64)).expect("drawn"));
            let ground = optical(&wanted).translation - ray * (optical(&wanted).translation.z / ray.z);
            let drawn = other.lens().project(optical(&place).inverse().transform_point(ground)).expect("drawn");
            prop_assert!(found.distance(drawn) < 0.01, "{found} {drawn}");
            compared += 1;
            if let Some((interpolated, _)) = warp.interpolated(u, v)
                && other.lens().contains(drawn)
            {
                off.push(interpolated.distance(drawn));
            }
        }
        off.sort_by(f64::total_cmp);
        prop_assert!(compared > 100, "{compared} places");
        if let Some(p99) = off.get(off.len() * 99 / 100) {
            prop_assert!(*p99 < 0.15, "{p99} px");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    /// Lenses that draw a circle, a body in the way: nothing is black that a source shows.
    #[test]
    fn whatever_a_source_shows_is_shown(
        places in prop::collection::vec((-0.4..0.4f64, -0.4..0.4f64, -40.0..40.0f64, 0..280usize), 2..4),
    ) {
        let (camera, world) = (lens_of(LensModel::KannalaBrandt { k: [0.0; 4] }, Some(150.0)), World::new(&field()));
        let images: Vec<Pyramid> = places.iter().map(|(.., body)| with_body(&camera, *body)).collect();
        let posed = |(x, y, yaw_deg, _): &(f64, f64, f64, usize)| pose(0.5 + x, 0.5 + y, *yaw_deg);
        let sources: Vec<Candidate> = (0..).zip(places.iter().zip(&images)).map(|(id, (place, image))| {
            Candidate { id, ..candidate(&camera, posed(place), image) }
        }).collect();
        let wanted = request(&camera, pose(0.5, 0.5, 0.0), &world);
        let of = |sources: &[Candidate]| view(&wanted, sources).map(|answer| answer.image.mask());
        let answer = view(&wanted, &sources).expect("a view");
        let all = answer.image.mask();
        prop_assert!((answer.sources.iter().map(|used| used.share).sum::<f64>() - 1.0).abs() < 1e-6);
        let alone: Vec<Vec<u8>> =
            sources.iter().map(|source| of(&[*source]).unwrap_or(vec![NOTHING; all.len()])).collect();
        for (source, own) in sources.iter().zip(&alone) {
            let lost = (0..all.len()).filter(|i| all[*i] == NOTHING && own[*i] != NOTHING);
            prop_assert_eq!(lost.map(|i| (i % 320, i / 320)).collect::<Vec<_>>(), vec![]);
            let is_only = |i: usize| own[i] != NOTHING && alone.iter().filter(|other| other[i] != NOTHING).count() == 1;
            let is_named = answer.sources.iter().any(|used| used.id == source.id);
            prop_assert!(is_named || !(0..all.len()).any(is_only), "shown, and not named: {:?}", answer.sources);
        }
    }
}

/// All of one brightness; a body from that column on, 40 wide, in the lower half.
fn with_body(camera: &Camera, left: usize) -> Pyramid {
    let (width, height) = (camera.width(), camera.height());
    let is_body = |i: usize| i / width > height / 2 && (left..left + 40).contains(&(i % width));
    let shows: Vec<bool> = camera.shows().iter().enumerate().map(|(i, shows)| *shows && !is_body(i)).collect();
    Pyramid::new(Raster::from_rgb(width, height, &vec![99; 3 * width * height], &shows).expect("fits"))
}

/// What the one hides behind its body the other one shows, though it is all in motion.
#[test]
fn an_image_that_only_shows_what_moves_is_named_too() {
    let (camera, world) = (Camera::new(&lens()), World::without_goals(&field()));
    let mut moving = with_body(&camera, 400).full().clone();
    moving.pixels.iter_mut().filter(|pixel| pixel[3] == SURE).for_each(|pixel| pixel[3] = UNSURE);
    let (still, moving) = (with_body(&camera, 150), Pyramid::new(moving));
    let sources = [
        candidate(&camera, pose(0.52, 0.5, 0.0), &still),
        Candidate { id: 1, ..candidate(&camera, pose(0.56, 0.5, 0.0), &moving) },
    ];
    let answer = view(&request(&camera, pose(0.5, 0.5, 0.0), &world), &sources).expect("a view");
    let named: Vec<u64> = answer.sources.iter().map(|used| used.id).collect();
    assert_eq!((named, answer.made), (vec![0, 1], Provenance::Composed));
    assert!((0.005..0.2).contains(&answer.sources[1].share), "{:?}", answer.sources);
    let alone = view(&request(&camera, pose(0.5, 0.5, 0.0), &world), &sources[..1]).expect("a view");
    assert!(alone.valid_share < answer.valid_share && alone.made == Provenance::Warped);
}

/// The nearer image is brighter at the edge of its circle than it should be: that is not shown up to the edge, where the other
/// one begins.
#[test]
fn seams_keep_away_from_the_edge_of_a_lens() {
    let (camera, world) =
        (lens_of(LensModel::KannalaBrandt { k: [0.0; 4] }, Some(120.0)), World::without_goals(&field()));
    let (width, height) = (camera.width(), camera.height());
    let bright = |i: usize| {
        let (u, v) = ((i % width) as f64 - 158.0, (i / width) as f64 - 121.0);
        if u.hypot(v) > 100.0 { 150 } else { 90 }
    };
    let rgb: Vec<u8> = (0..width * height).flat_map(|i| [bright(i); 3]).collect();
    let near = Pyramid::new(Raster::from_rgb(width, height, &rgb, camera.shows()).expect("fits"));
    let wide = lens_of(LensModel::KannalaBrandt { k: [0.0; 4] }, Some(180.0));
    let far = Pyramid::new(Raster::from_rgb(width, height, &vec![90; 3 * width * height], wide.shows()).expect("fits"));
    let sources = [candidate(&camera, pose(0.52, 0.5, 0.0), &near), candidate(&wide, pose(0.62, 0.5, 0.0), &far)];
    let mut wanted = request(&wide, pose(0.5, 0.5, 0.0), &world);
    wanted.settings.stored_within_m = -1.0;
    let image = view(&wanted, &sources).expect("a view").image;
    let row = &image.pixels[170 * width..171 * width];
    let steps: Vec<u8> = row
        .windows(2)
        .filter(|two| two.iter().all(|p| p[3] == SURE))
        .map(|two| two[0][0].abs_diff(two[1][0]))
        .collect();
    assert!(steps.iter().all(|step| *step <= 20), "{steps:?}");
}

#[test]
fn a_view_from_where_an_image_was_taken_is_that_image() {
    let (camera, world) = (Camera::new(&lens()), World::new(&field()));
    let noise: Vec<u8> = (0..320 * 240 * 3u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let raster = Raster::from_rgb(320, 240, &noise, camera.shows()).expect("fits");
    let (place, image) = (pose(0.5, 0.5, 10.0), Pyramid::new(raster.clone()));
    let wanted = request(&camera, place, &world);
    let stored = view(&wanted, &[candidate(&camera, place, &image)]).expect("a view");
    assert_eq!((stored.made, &stored.image), (realitysim::views::Provenance::Stored, &raster));
    // Through the map as well, but for pixels at the image's border.
    let mut through = wanted;
    through.settings.stored_within_m = -1.0;
    let warped = view(&through, &[candidate(&camera, place, &image)]).expect("a view");
    let pairs = warped.image.pixels.iter().zip(&raster.pixels).filter(|(pixel, _)| pixel[3] > 0);
    let most = pairs.flat_map(|(a, b)| (0..3).map(|c| a[c].abs_diff(b[c]))).max();
    assert!(most.is_some_and(|most| most <= 6), "{most:?} of 255: less than a 64th of a pixel");
}

#[test]
fn what_cannot_be_shown_is_refused_in_words() {
    let (camera, world) = (Camera::new(&lens()), World::new(&field()));
    let image = gray(&camera);
    let source = candidate(&camera, pose(0.0, 0.0, 0.0), &image);
    let said = |place: Isometry| view(&request(&camera, place, &world), &[source]).expect_err("refused").to_string();
    let at = |x: f64, z: f64| Isometry { translation: DVec3::new(x, 0.0, z), ..pose(0.0, 0.0, 90.0) };
    assert!(said(at(f64::NAN, 0.5)).contains("not finite"));
    assert!(said(at(0.0, -0.5)).contains("-0.500 m above the ground"));
    assert!(said(at(0.0, 21.0)).contains("0.02 to 20 m"));
    assert_eq!(view(&request(&camera, at(0.0, 0.5), &world), &[]), Err(ViewError::NoCandidates));
    let mut near = request(&camera, at(3.0, 0.5), &world);
    near.settings = ViewSettings { max_distance_m: 1.0, ..near.settings };
    assert!(matches!(view(&near, &[source]), Err(ViewError::TooFar { .. })));
    // Near by, and looking the other way.
    let behind = Euler { yaw: core::f64::consts::PI, pitch: 0.3, roll: 0.0 };
    let mut away = request(&camera, Isometry::from_euler(behind, DVec3::new(0.0, 0.0, 0.5)), &world);
    let shown = view(&away, &[source]).map(|answer| answer.valid_share);
    assert!(shown.as_ref().is_ok_and(|share| *share < 0.25), "whatever there is: {shown:?}");
    away.settings = ViewSettings { max_distance_m: 1.0, ..away.settings };
    let said = view(&away, &[source]).expect_err("refused").to_string();
    assert!(said.contains("less than the 25 %") && said.contains("looking that way"), "{said}");
    // Looking straight up there is no ground for the paper's map.
    let euler = Euler { yaw: 0.0, pitch: -1.5, roll: 0.0 };
    let mut up = request(&camera, Isometry::from_euler(euler, DVec3::new(0.1, 0.0, 0.5)), &world);
    up.method = Method::Paper;
    let narrow = lens_of(LensModel::PlumbBob { d: [0.0; 5] }, Some(60.0));
    up.camera = &narrow;
    assert!(matches!(view(&up, &[source]), Err(ViewError::Fit(_))));
}
