//! Odometry: poses, or velocities that are integrated.

use super::Measured;
use super::stamp::{InOrder, StampColumn};
use super::table::{Table, TableError};
use super::units::{AngleUnit, Quantity};
use realitysim_geometry::{Physical, Pose2};

/// The pose of `base_footprint` as the robot counts its steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometrySample {
    /// Time of the measurement, nanoseconds.
    pub stamp_ns: i64,
    /// Position in metres and heading in radians, in the coordinate frame `odom`.
    pub odom_from_footprint: Pose2,
}

/// Time between two velocities from which the walk between them is not known, nanoseconds.
const LONG_STEP_NS: i64 = 500_000_000;

/// Reads a table of poses (`x`, `y`, and `yaw` or `theta` with a unit) or of velocities of the robot along its own axes (`vx`, perhaps `vy`, and
/// `wz` with a unit), which are integrated from the origin on.
pub fn read(table: &mut Table, angles: Option<AngleUnit>) -> Result<Measured<OdometrySample>, TableError> {
    let stamps = StampColumn::find(table)?.ok_or_else(|| table.lacks("the column stamp (or time, t) is missing"))?;
    let position = table.take_numbers([&["x"], &["y"]], Quantity::Length, None)?;
    let yaw = table.take_number(&["yaw", "theta", "heading"], Quantity::Angle, angles)?;
    let mut assumed = Vec::new();
    if let (Some([x, y]), Some(yaw)) = (position, yaw) {
        let (mut rows, mut order) = (Vec::new(), InOrder::default());
        for row in table.rows() {
            let row = row?;
            let stamp_ns = stamps.read(&row)?;
            order.check(&row, stamp_ns)?;
            let [x, y, yaw] = row.numbers([x, y, yaw])?;
            let odom_from_footprint = Pose2::new(x, y, yaw);
            if !odom_from_footprint.is_possible() {
                return Err(row.error(format!("x {x}, y {y} m is no place on the ground: is the unit right?")));
            }
            rows.push(OdometrySample { stamp_ns, odom_from_footprint });
        }
        return finish(table, rows, stamps, assumed);
    }
    if position.is_some() {
        return Err(table.lacks("the column yaw_deg (or yaw_rad, theta_rad) is missing beside x and y"));
    }
    let forward = table.take_number(&["vx"], Quantity::Speed, None)?;
    let left = table.take_number(&["vy"], Quantity::Speed, None)?;
    let turn = table.take_number(&["wz", "vyaw", "vtheta"], Quantity::TurnRate, angles)?;
    let (Some(forward), Some(turn)) = (forward, turn) else {
        return Err(table.lacks("there are neither poses (x,y,yaw_deg) nor velocities (vx,vy,wz_deg_s)"));
    };
    if left.is_none() {
        assumed.push("no vy: the robot is taken never to step sideways".to_owned());
    }
    let (mut rows, mut order, mut long_steps) = (Vec::new(), InOrder::default(), 0u64);
    let mut before: Option<(i64, [f64; 3], Pose2)> = None;
    for row in table.rows() {
        let row = row?;
        let stamp_ns = stamps.read(&row)?;
        order.check(&row, stamp_ns)?;
        let [x, turn] = row.numbers([forward, turn])?;
        let y = left.map_or(Ok(0.0), |column| row.number(column))?;
        let twist = [x, y, turn];
        let pose = match before {
            None => Pose2::default(),
            Some((last_ns, last, pose)) => {
                let step_ns = stamp_ns - last_ns;
                long_steps += u64::from(step_ns > LONG_STEP_NS);
                let mean = core::array::from_fn(|i| 0.5 * (last[i] + twist[i]));
                pose.compose(&along_arc(mean, step_ns as f64 * 1e-9))
            }
        };
        if !pose.is_possible() {
            return Err(row.error("the velocities lead out of all range: is the unit right?".to_owned()));
        }
        rows.push(OdometrySample { stamp_ns, odom_from_footprint: pose });
        before = Some((stamp_ns, twist, pose));
    }
    assumed.push("velocities are integrated, along an arc with the mean velocity between two rows".to_owned());
    if long_steps > 0 {
        assumed.push(format!(
            "{long_steps} times more than 0.5 s lie between two velocities: the walk between them is not known"
        ));
    }
    finish(table, rows, stamps, assumed)
}

fn finish(
    table: &Table,
    rows: Vec<OdometrySample>,
    stamps: StampColumn,
    assumed: Vec<String>,
) -> Result<Measured<OdometrySample>, TableError> {
    if rows.is_empty() {
        return Err(table.error(None, "there is no row behind the head".to_owned()));
    }
    Ok(Measured { rows, stamps: Some(stamps.unit), assumed })
}

/// Turn below which an arc is a straight line to within rounding, radians.
const STRAIGHT_RAD: f64 = 1e-9;

/// The motion with a constant velocity (metres and radians per second, along the axes of the moving robot) for some seconds.
fn along_arc([vx, vy, turn_rate]: [f64; 3], seconds: f64) -> Pose2 {
    let (x, y, turn) = (vx * seconds, vy * seconds, turn_rate * seconds);
    // sin(turn) / turn and (1 - cos(turn)) / turn: the exponential map of SE(2).
    let (along, across) = if turn.abs() < STRAIGHT_RAD {
        (1.0, 0.5 * turn)
    } else {
        (libm::sin(turn) / turn, (1.0 - libm::cos(turn)) / turn)
    };
    Pose2::new(along * x - across * y, across * x + along * y, turn)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn samples(text: &str) -> Result<Vec<OdometrySample>, TableError> {
        read(&mut Table::parse(text, "odometry.csv")?, None).map(|measured| measured.rows)
    }

    proptest! {
        /// The oracle walks the same way in ten thousand straight steps.
        #[test]
        fn an_arc_is_the_sum_of_its_small_steps(vx in -1.0..1.0, vy in -1.0..1.0, turn in -3.0..3.0, seconds in 0.0..2.0) {
            let steps = 10_000;
            let step_s = seconds / f64::from(steps);
            let small = Pose2::new(vx * step_s, vy * step_s, turn * step_s);
            let walked = (0..steps).fold(Pose2::default(), |pose, _| pose.compose(&small));
            let arc = along_arc([vx, vy, turn], seconds);
            prop_assert!(walked.distance(&arc) < 1e-3, "{walked:?} {arc:?}");
        }
    }

    #[test]
    fn velocities_and_poses_of_the_same_circle_agree() {
        let velocities = (0..=100).map(|i| format!("{:.2},0.25,30\n", f64::from(i) * 0.02)).collect::<String>();
        let samples = samples(&format!("t,vx,wz_deg_s\n{velocities}")).expect("velocities");
        let end = samples.last().expect("rows").odom_from_footprint;
        let (radius, turn) = (0.25 / 30f64.to_radians(), 60f64.to_radians());
        let expected = Pose2::new(radius * turn.sin(), radius * (1.0 - turn.cos()), turn);
        assert!(end.distance(&expected) < 1e-9 && (end.yaw - expected.yaw).abs() < 1e-9, "{end:?}");
    }

    #[test]
    fn what_is_missing_or_wrong_is_named() {
        for (text, words) in [
            ("x,y,yaw_deg\n0,0,0\n", &["column stamp", "x, y, yaw_deg"][..]),
            ("t,x,y\n0.0,0,0\n", &["yaw_deg"]),
            ("t,x,y,theta\n0.0,0,0,0\n", &["theta_deg or theta_rad", "--angles"]),
            ("t,x,yaw_deg\n0.0,0,0\n", &["the column y is missing beside x"]),
            ("t,vx,wz\n0.0,0,0\n", &["wz_deg_s or wz_rad_s"]),
            ("t,x,y,yaw_deg\n0.0,0,0,0\n0.1,0,0,0\n\n0.1,0,0,0\n", &["line 5", "the same as that of line 3"]),
            ("t,x,y,yaw_deg\n0.2,0,0,0\n0.1,0,0,0\n", &["line 3", "earlier than that of line 2"]),
            ("t,x,y,yaw_deg\n0.2,0,zero,0\n", &["line 2", "y \"zero\": it is no number"]),
            ("t;x;y;yaw_deg\n0.2;0,5;0;0\n", &["x \"0,5\"", "decimal point"]),
            ("t,x,y,yaw_deg\n0.2,0,0\n", &["line 2", "3 cells, and the head has 4"]),
            ("t,x,y,yaw_deg,theta_rad\n0.2,0,0,0,0\n", &["both yaw_deg and theta_rad"]),
            ("t,x,y,yaw_deg\n", &["no row"]),
            ("", &["empty"]),
            ("0.0,1,2,3\n", &["a head that names the columns is needed"]),
        ] {
            let error = samples(text).expect_err(text).to_string();
            assert!(
                error.starts_with("odometry.csv: ") && words.iter().all(|word| error.contains(word)),
                "{text}: {error}"
            );
        }
    }

    #[test]
    fn delimiters_comments_and_units_are_recognized() {
        let expected = samples("stamp_s,x,y,yaw_deg\n1,0.5,0.25,90\n").expect("commas");
        for text in [
            "stamp_s;x;y;yaw_deg\n1;0.5;0.25;90\n",
            "stamp_s\tx\ty\tyaw_deg\r\n1\t0.5\t0.25\t90\r\n",
            "# stamp_s,x,y,yaw_deg\n# of a walk\n1,0.5,0.25,90\n",
            "\u{feff}Stamp [s], X (mm), \"Y (cm)\", Yaw [deg],\n1,500,25,90,\n",
            "stamp_ms,x_m,y_m,heading_rad,battery\n1000,0.5,0.25,1.5707963267948966,7\n",
        ] {
            let found = samples(text).expect(text);
            assert_eq!(found.len(), 1, "{text}");
            let (found, expected) = (found[0], expected[0]);
            assert_eq!(found.stamp_ns, expected.stamp_ns, "{text}");
            assert!(found.odom_from_footprint.distance(&expected.odom_from_footprint) < 1e-12, "{text}: {found:?}");
        }
    }
}
