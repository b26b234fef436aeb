use glam::DVec3;
use realitysim::config::*;
use realitysim::geometry::*;
use realitysim::localization::*;
use realitysim::vision::*;
use std::time::Instant;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let name = &args[1];
    let get = |k: &str, d: f64| args.iter().position(|a| a == k).map_or(d, |i| args[i + 1].parse().unwrap());
    let lens = Lens::new(LensParameters {
        width: 640,
        height: 480,
        fx: 205.,
        fy: 205.,
        cx: 322.,
        cy: 236.,
        model: LensModel::KannalaBrandt { k: [-0.012, 0.003, -0.0008, 0.0] },
        fov_deg: None,
    })
    .unwrap();
    let dims: FieldDimensions =
        toml::from_str(&std::fs::read_to_string("config/fields/kid-2009.toml").unwrap()).unwrap();
    let field = Field::new(dims).unwrap();
    let model = if args.iter().any(|a| a == "distance") { Model::Distance } else { Model::Gauss };
    let formula = if args.iter().any(|a| a == "paper") { Formula::Paper } else { Formula::Corrected };
    let vs = VisionSettings {
        reading: observation::reading(model, formula),
        range_m: get("range", 4.0),
        tilt_sigma_rad: get("tilt", 0.7f64).to_radians(),
        nearest_reach_m: 0.25,
    };
    let vision = Vision::new(lens.clone(), vs);
    let obs = Observation::new(&field, 350, get("alpha", observation::default_alpha(formula)), SimdPath::Auto);
    let csv = std::fs::read_to_string(format!("/tmp/look/{name}/frames.csv")).unwrap();
    let mut lines = csv.lines().map(|l| l.split(' ').map(|v| v.parse::<f64>().unwrap()).collect::<Vec<_>>());
    let ip = lines.next().unwrap();
    let settings = FilterSettings {
        particles: get("n", 800.0) as usize,
        iterations: get("t", 5.0) as usize,
        motion: MotionModel::default(),
        jitter: Spread { xy_m: get("jxy", 0.04), yaw_rad: get("jyaw", 1.5f64).to_radians() },
        jitter_shrink: get("shrink", 0.6),
        seed: get("seed", 1.0) as u64,
    };
    let mut filter = Filter::new(settings, obs, FilterState { particles: Particles::default(), steps: 0 });
    filter.restart(Pose2::new(ip[0], ip[1], ip[2]), Spread { xy_m: 0.1, yaw_rad: 0.06 });
    let mut last: Option<(f64, Pose2)> = None;
    let (mut errs, mut yaws, mut tv, mut tf, mut shares) = (vec![], vec![], vec![], vec![], vec![]);
    let truth_tilt = args.iter().any(|a| a == "truetilt");
    for (i, f) in lines.enumerate() {
        let img = image::open(format!("/tmp/look/{name}/{i:04}.jpg")).unwrap().to_rgb8();
        let pic = Picture::from_rgb(img.width() as usize, img.height() as usize, img.as_raw()).unwrap();
        let odom = Pose2::new(f[1], f[2], f[3]);
        let (dt, step) = last.map_or((0.0, Pose2::default()), |(t, o)| (f[0] - t, o.inverse().compose(&odom)));
        last = Some((f[0], odom));
        let torso = Isometry::from_euler(Euler { yaw: 0.0, pitch: f[4], roll: f[5] }, DVec3::new(0., 0., 0.44));
        let mount =
            Isometry::from_euler(Euler { yaw: 0.0, pitch: 17f64.to_radians(), roll: 0.0 }, DVec3::new(0.04, 0.0, 0.11));
        let mut fc = torso * mount;
        let truth = Isometry::from_euler(Euler { yaw: f[9], pitch: f[10], roll: f[11] }, DVec3::new(f[6], f[7], f[8]));
        if truth_tilt {
            fc = Isometry::from_euler(
                Euler { yaw: fc.euler().yaw, pitch: f[10], roll: f[11] },
                DVec3::new(fc.translation.x, fc.translation.y, f[8]),
            );
        }
        let fo = fc * Isometry::link_from_optical();
        let t0 = Instant::now();
        let table = vision.look(&pic, &fo, None);
        let t1 = Instant::now();
        let e = filter.step(Some(step), dt, &table.table);
        let t2 = Instant::now();
        let cam = e.best.to_isometry() * fc;
        let err = (cam.translation - truth.translation).truncate().length() * 100.0;
        let s = if true { filter.observation().support(table.lines(), &e.best) } else { Support::default() };
        errs.push(err);
        shares.push(s.share);
        yaws.push(wrap_angle(cam.euler().yaw - f[9]).to_degrees().abs());
        tv.push((t1 - t0).as_secs_f64() * 1e3);
        tf.push((t2 - t1).as_secs_f64() * 1e3);
        if args.iter().any(|a| a == "-v") {
            println!(
                "{i} err {err:.1} yaw {:.2} share {:.2} w {:.0} n {} ess {:.0} spread {:.3}",
                yaws[i], s.share, s.weight, s.points, e.effective_sample_size, e.spread_m
            );
        }
        if get("pic", -1.0) as usize == i {
            let mut out = image::RgbImage::new(400, 400);
            for y in 0..400 {
                for x in 0..400 {
                    let l = table.table.level(x, y);
                    out.put_pixel((399 - y) as u32, (399 - x) as u32, image::Rgb([l, l, if l == 64 { 0 } else { l }]));
                }
            }
            out.save("/tmp/look/table.png").unwrap();
        }
    }
    let st = |v: &mut Vec<f64>| {
        v.sort_by(f64::total_cmp);
        let n = v.len();
        format!(
            "mean {:.2} med {:.2} p95 {:.2} max {:.2}",
            v.iter().sum::<f64>() / n as f64,
            v[n / 2],
            v[n * 95 / 100],
            v[n - 1]
        )
    };
    println!(
        "cm   {}\nyaw  {}\nshare {} min {}\nvision ms {}\nfilter ms {}",
        st(&mut errs),
        st(&mut yaws),
        st(&mut shares),
        shares[0],
        st(&mut tv),
        st(&mut tf)
    );
}
