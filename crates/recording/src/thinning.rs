//! Thinning: which frames are worth their bytes.
//!
//! The decision is pure: it depends on the frames that were kept and on the pose of this one.

use realitysim_config::{ThinningMode, ThinningSettings};
use realitysim_geometry::{Isometry, PoseGrid};

/// Memory of thinning over one session.
#[derive(Clone, Debug)]
pub struct Thinning {
    settings: ThinningSettings,
    /// Number of kept images of known pose, by cell.
    grid: PoseGrid,
    /// Pose of the last frame that was kept and whose pose is known.
    last_kept: Option<Isometry>,
    rate: Rate,
    unknown: Rate,
}

/// Limiter that lets frames through at a mean rate.
#[derive(Clone, Copy, Debug)]
struct Rate {
    period_ns: i64,
    last_ns: Option<i64>,
    due_ns: i64,
}

impl Thinning {
    /// Begins a session; `grid` is empty, or holds the images of earlier sessions.
    pub fn new(settings: ThinningSettings, grid: PoseGrid) -> Self {
        let (rate, unknown) = (Rate::new(settings.rate_hz), Rate::new(settings.unknown_hz));
        Self { settings, grid, last_kept: None, rate, unknown }
    }

    /// Whether a frame has to be tagged before it is known if it is written.
    pub fn thins(&self) -> bool {
        self.settings.mode != ThinningMode::All
    }

    /// Number of kept images, by cell.
    pub fn coverage(&self) -> &PoseGrid {
        &self.grid
    }

    /// Whether the frame with this stamp is kept; a kept frame is remembered.
    ///
    /// `pose` is the pose of `camera_link` in `map`, if the tag is valid, and `sigma_m` the standard deviation of its
    /// position along the longer axis in x and y, m.
    pub fn keeps(&mut self, stamp_ns: i64, pose: Option<&Isometry>, sigma_m: f64) -> bool {
        let known = pose.filter(|_| 100.0 * sigma_m <= self.settings.max_sigma_cm);
        let keeps = match (self.settings.mode, known) {
            (ThinningMode::All, _) => true,
            (ThinningMode::Rate, _) => self.rate.lets_through(stamp_ns),
            // Without a pose nobody knows whether the frame shows anything new.
            (_, None) => self.unknown.lets_through(stamp_ns),
            (ThinningMode::Novelty, Some(pose)) => self.is_new(pose),
            (ThinningMode::Coverage, Some(pose)) => self.is_wanted(pose) && self.is_new(pose),
        };
        if let (true, Some(pose)) = (keeps, pose) {
            self.grid.add(pose);
            self.last_kept = Some(*pose);
        }
        keeps
    }

    /// Whether the pose has moved or turned far enough from the last one that was kept.
    fn is_new(&self, pose: &Isometry) -> bool {
        self.last_kept.is_none_or(|last| {
            let between = last.rotation.conjugate() * pose.rotation;
            let turned = 2.0 * libm::atan2(between.xyz().length(), between.w.abs());
            pose.translation.distance(last.translation) >= 0.01 * self.settings.novelty_cm
                || turned >= self.settings.novelty_deg.to_radians()
        })
    }

    /// Whether the cell of the pose lacks images; off the carpet none is wanted.
    fn is_wanted(&self, pose: &Isometry) -> bool {
        self.grid.images_at(pose).is_some_and(|images| images < self.settings.images_per_cell)
    }
}

impl Rate {
    fn new(hz: f64) -> Self {
        Self { period_ns: (1e9 / hz) as i64, last_ns: None, due_ns: i64::MIN }
    }

    fn lets_through(&mut self, stamp_ns: i64) -> bool {
        // After the clock was set back, the rate starts anew.
        let anew = self.last_ns.is_none_or(|last| stamp_ns < last);
        if !anew && stamp_ns < self.due_ns {
            return false;
        }
        let late = anew || stamp_ns.saturating_sub(self.due_ns) >= self.period_ns;
        self.due_ns = if late { stamp_ns } else { self.due_ns }.saturating_add(self.period_ns);
        self.last_ns = Some(stamp_ns);
        true
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec2, DVec3};
    use proptest::prelude::*;

    use super::*;

    fn thinning(mode: ThinningMode) -> Thinning {
        let settings = ThinningSettings { mode, images_per_cell: 2, ..ThinningSettings::default() };
        Thinning::new(settings, PoseGrid::new(DVec2::new(3.0, 2.0), 0.5, 8))
    }

    fn pose(x: f64, yaw_deg: f64) -> Isometry {
        Isometry::new(DQuat::from_rotation_z(yaw_deg.to_radians()), DVec3::new(x, 0.1, 0.5))
    }

    const FRAME_NS: i64 = 33_333_333;

    #[test]
    fn a_rate_is_kept_in_the_mean() {
        let mut thinning = thinning(ThinningMode::Rate);
        thinning.rate = Rate::new(7.0);
        let kept = (0..3_000).filter(|frame| thinning.keeps(frame * FRAME_NS, None, 0.0)).count();
        assert!((698..=702).contains(&kept), "{kept} in 100 s at 7 Hz");
        // Frames that did not come during a pause are not made up for, and a clock that is set back does not stop it.
        let from = 1_000_000_000_000;
        assert!(thinning.keeps(from, None, 0.0) && !thinning.keeps(from + FRAME_NS, None, 0.0));
        assert!(thinning.keeps(0, None, 0.0));
    }

    #[test]
    fn novelty_keeps_a_standing_robot_once_and_a_walking_one_by_distance() {
        let mut thinning = thinning(ThinningMode::Novelty);
        let mut kept = |x: f64, yaw: f64| thinning.keeps(0, Some(&pose(x, yaw)), 0.01);
        assert!(kept(0.0, 0.0));
        assert!(!kept(0.0, 0.0) && !kept(0.099, 9.9));
        assert!(kept(0.1001, 0.0));
        assert!(kept(0.1001, 10.01) && !kept(0.1001, 10.01));
        assert!(kept(0.1001, 359.0), "11 degrees the short way");
    }

    #[test]
    fn a_cell_gets_its_images_and_no_more() {
        let mut thinning = thinning(ThinningMode::Coverage);
        let kept =
            (0..100).filter(|step| thinning.keeps(0, Some(&pose(0.1 + 0.3 * f64::from(step % 2), 20.0)), 0.01)).count();
        assert_eq!(kept, 2, "two far enough apart in one cell");
        assert!(thinning.keeps(0, Some(&pose(0.1, 60.0)), 0.01), "another heading");
        assert!(!thinning.keeps(0, Some(&pose(7.0, 0.0)), 0.01), "off the carpet");
        assert!(thinning.keeps(0, Some(&pose(0.1, 120.0)), 0.05), "known too badly to be judged: one a second");
        assert!(!thinning.keeps(1, Some(&pose(0.1, 180.0)), 0.05));
        assert_eq!(thinning.coverage().filled, 3);
    }

    #[test]
    fn what_has_no_pose_is_kept_now_and_then() {
        for mode in [ThinningMode::Novelty, ThinningMode::Coverage] {
            let mut thinning = thinning(mode);
            let kept = (0..300).filter(|frame| thinning.keeps(frame * FRAME_NS, None, 0.0)).count();
            assert_eq!(kept, 10, "{mode:?}: ten seconds at 1 Hz");
        }
    }

    proptest! {
        #[test]
        fn what_is_kept_by_novelty_is_new_and_what_is_not_is_near_what_was_kept(
            steps in prop::collection::vec((-0.2..0.2_f64, -20.0..20.0_f64), 1..60),
        ) {
            let mut thinning = thinning(ThinningMode::Novelty);
            let (mut x, mut yaw, mut last) = (0.0, 0.0, None::<(f64, f64)>);
            for (dx, dyaw) in steps {
                (x, yaw) = (x + dx, yaw + dyaw);
                let turned = last.map_or(0.0, |(_, old)| realitysim_geometry::wrap_angle((yaw - old).to_radians()).abs().to_degrees());
                let new = last.is_none_or(|(old, _)| (x - old).abs() >= 0.1) || turned >= 10.0;
                prop_assert_eq!(thinning.keeps(0, Some(&pose(x, yaw)), 0.01), new);
                if new {
                    last = Some((x, yaw));
                }
            }
        }
    }
}
