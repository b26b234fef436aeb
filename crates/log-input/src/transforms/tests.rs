use super::*;

fn names() -> FrameNames {
    FrameNames::default()
}

fn robot() -> TransformTree {
    let mut tree = TransformTree::default();
    let at = |x, z| Isometry::new(DQuat::IDENTITY, DVec3::new(x, 0.0, z));
    let pitched = Isometry::from_euler(Euler { pitch: 0.3, ..Euler::default() }, DVec3::new(0.04, 0.0, 0.11));
    tree.set_static("base_footprint", "base_link", at(0.0, 0.44));
    tree.set_static("base_link", "camera_link", pitched);
    tree.set_static("camera_link", "camera_optical_frame", Isometry::link_from_optical());
    tree
}

/// REP 105 has the torso below the footprint, REP 120 the footprint below the torso: the camera is at the same place.
#[test]
fn a_footprint_that_hangs_on_the_torso_gives_the_same_camera() {
    let lifted = Isometry::new(DQuat::IDENTITY, DVec3::new(0.0, 0.0, 0.44));
    let mut hanging = TransformTree::default();
    hanging.set_static("base_link", "base_footprint", lifted.inverse());
    hanging.push(0, "odom", "base_link", Isometry::new(DQuat::IDENTITY, DVec3::X));
    for (parent, child) in [("base_link", "camera_link"), ("camera_link", "camera_optical_frame")] {
        let Some(Edge { transform: Transform::Static(constant), .. }) = robot().edges.get(child).cloned() else {
            panic!("constants")
        };
        hanging.set_static(parent, child, constant);
    }
    let attitude = Some(Euler { roll: 0.05, pitch: 0.1, yaw: 2.0 }.rotation());
    for attitude in [None, attitude] {
        let posture = Posture { attitude, head: Some(Head { pan: 0.2, tilt: 0.1 }) };
        let expected = robot().camera_place(0, &names(), posture).expect("a whole chain");
        let found = hanging.camera_place(0, &names(), posture).expect("a whole chain");
        let apart = found.footprint_from_optical.inverse() * expected.footprint_from_optical;
        assert!(apart.translation.length() < 1e-12 && apart.rotation.angle_between(DQuat::IDENTITY) < 1e-7);
        assert_eq!(found.tilt_is_measured, expected.tilt_is_measured);
        assert_eq!(found.lean_rad.is_some(), expected.lean_rad.is_some());
    }
    assert!(hanging.check_constants(&names(), false).is_ok());
    let step = hanging.base_from_footprint(0, &names()).expect("it hangs there");
    assert!((step.translation + DVec3::Z * 0.44).length() < 1e-12);
    assert_eq!(robot().base_from_footprint(0, &names()), None);
}

#[test]
fn a_chain_that_never_meets_is_broken_and_one_that_turns_is_a_circle() {
    let mut tree = robot();
    tree.set_static("ground", "base_footprint", Isometry::IDENTITY);
    tree.edges.remove("base_link");
    let broken = tree.camera_place(0, &names(), Posture::default()).expect_err("two trees");
    assert!(matches!(broken, ChainError::Broken { frame, .. } if frame == "base_link"));
    tree.set_static("base_footprint", "ground", Isometry::IDENTITY);
    let circle = tree.camera_place(0, &names(), Posture::default()).expect_err("a circle above the footprint");
    assert!(matches!(circle, ChainError::Circle { .. }));
}

#[test]
fn a_fixed_camera_stands_where_the_constants_say() {
    let place = robot().camera_place(0, &names(), Posture::default()).expect("a whole chain");
    assert!((place.footprint_from_link.translation - DVec3::new(0.04, 0.0, 0.55)).length() < 1e-12);
    assert!((place.footprint_from_link.euler().pitch - 0.3).abs() < 1e-12);
}

#[test]
fn the_torso_s_tilt_moves_the_camera_and_its_yaw_does_not() {
    let attitude = Some(Euler { yaw: 2.0, pitch: 0.1, roll: 0.0 }.rotation());
    let place = robot().camera_place(0, &names(), Posture { attitude, head: None }).expect("a whole chain");
    let euler = place.footprint_from_link.euler();
    assert!((euler.pitch - 0.4).abs() < 1e-12 && euler.yaw.abs() < 1e-12);
    let expected =
        DVec3::new(0.04 * 0.1f64.cos() + 0.11 * 0.1f64.sin(), 0.0, 0.44 + 0.11 * 0.1f64.cos() - 0.04 * 0.1f64.sin());
    assert!((place.footprint_from_link.translation - expected).length() < 1e-12);
}

#[test]
fn a_head_pans_before_it_tilts() {
    let head = Some(Head { pan: 0.7, tilt: 0.2 });
    let place = robot().camera_place(0, &names(), Posture { attitude: None, head }).expect("a whole chain");
    let expected = Euler { yaw: 0.7, pitch: 0.5, roll: 0.0 };
    let got = place.footprint_from_link.euler();
    assert!(
        (got.yaw - expected.yaw).abs() < 1e-12 && (got.pitch - expected.pitch).abs() < 1e-12 && got.roll.abs() < 1e-12
    );
}

#[test]
fn a_torso_that_moves_in_tf_is_not_tilted_twice() {
    let mut tree = robot();
    let tilted = Isometry::from_euler(Euler { pitch: 0.1, ..Euler::default() }, DVec3::new(0.0, 0.0, 0.44));
    tree.push(50, "base_footprint", "base_link", tilted);
    let attitude = Some(Euler { pitch: 0.5, ..Euler::default() }.rotation());
    let place = tree.camera_place(50, &names(), Posture { attitude, head: None }).expect("a whole chain");
    assert!((place.footprint_from_link.euler().pitch - 0.4).abs() < 1e-12);
}

#[test]
fn the_tilt_is_measured_by_an_attitude_or_by_what_moves_above_the_torso() {
    let measured = |tree: &TransformTree, attitude: Option<DQuat>| {
        let place = tree.camera_place(50, &names(), Posture { attitude, head: None });
        place.expect("a whole chain").tilt_is_measured
    };
    assert_eq!([None, Some(DQuat::IDENTITY)].map(|attitude| measured(&robot(), attitude)), [false, true]);
    let moving = |parent: &str, child: &str| {
        let mut tree = robot();
        tree.push(50, parent, child, Isometry::IDENTITY);
        tree
    };
    assert!(measured(&moving("base_footprint", "base_link"), None));
    assert!(!measured(&moving("base_link", "camera_link"), None), "only the head moves");
    let mut without_torso = robot();
    without_torso.set_static("base_footprint", "camera_link", Isometry::IDENTITY);
    assert!(!measured(&without_torso, Some(DQuat::IDENTITY)), "the attitude has nothing to act on");
}

#[test]
fn what_is_missing_is_named() {
    let mut tree = robot();
    tree.edges.remove("base_link");
    let error = tree.check_mount(0, &names()).expect_err("no base_link").to_string();
    assert!(error.contains("the chain ends at base_link"), "{error}");
    tree.set_static("camera_optical_frame", "base_link", Isometry::IDENTITY);
    assert!(matches!(tree.check_mount(0, &names()), Err(ChainError::Circle { .. })));
}

#[test]
fn a_mount_of_zeros_is_refused() {
    let mut tree = TransformTree::default();
    tree.set_static("base_footprint", "base_link", Isometry::IDENTITY);
    tree.set_static("base_link", "camera_link", Isometry::IDENTITY);
    tree.set_static("camera_link", "camera_optical_frame", Isometry::IDENTITY);
    assert!(matches!(tree.check_mount(0, &names()), Err(ChainError::NoHeight { .. })));
    tree.set_static("base_footprint", "base_link", Isometry::new(DQuat::IDENTITY, DVec3::Z * 0.5));
    assert!(matches!(tree.check_mount(0, &names()), Err(ChainError::LooksUp { .. })));
}
