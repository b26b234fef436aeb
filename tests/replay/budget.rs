//! Adaptive sampling, and a budget of time for each frame.

use super::support::{Replayed, Room, assert_same, session_name, walk};

/// So much that any machine runs out of time, so little that some of it is left.
const CAPPED: &str = "--set filter.adaptive=false --set filter.particles=60000 --set filter.budget_ms=12";

fn capped(replayed: &Replayed) -> usize {
    replayed.tags.iter().filter(|tag| tag.capped).count()
}

#[test]
fn what_the_clock_decided_is_decided_again_in_a_replay_of_the_capture() {
    let room = Room::with_walk();
    let first = room.replay(&format!("log.mcap {CAPPED}"));
    assert!(capped(&first) > 0 && first.count("capped") == capped(&first), "{}", first.report);
    for tag in first.tags.iter().filter(|tag| tag.capped) {
        assert!(tag.stopped_at > 0 && tag.weighed >= tag.stopped_at && tag.particles < 60_000, "{tag:?}");
    }
    let session = session_name(&first);
    // A clock that has all the time there is, other kernels, other threads: the recorded decisions count.
    let generous = CAPPED.replace("budget_ms=12", "budget_ms=10000");
    for how in ["--threads 1", "--threads 2", "--simd scalar"] {
        let again = room.replay(&format!("{session} {generous} {how}"));
        let same_clock: Vec<_> = again.tags.iter().zip(&first.tags).collect();
        assert!(same_clock.iter().all(|(one, other)| one.stopped_at == other.stopped_at), "{how}");
        assert_same(&again.tags, &first.tags, how);
    }
    // Without a budget nothing is cut short.
    assert_eq!(capped(&room.replay(&format!("{session} --set filter.adaptive=false"))), 0);
}

#[test]
fn a_budget_that_cannot_be_kept_is_told_and_costs_particles_not_frames() {
    let room = Room::with_walk();
    let hurried = room.replay("log.mcap --set filter.budget_ms=0.1 --set filter.adaptive=false");
    assert_eq!(hurried.tags.len(), walk().frames());
    assert_eq!((capped(&hurried), hurried.count("over_budget")), (walk().frames(), walk().frames()));
    let told = &hurried.run.stderr;
    assert!(told.contains("filter.budget_ms = 0.1") && told.contains("seeing and refining alone"), "{told}");
    assert!(hurried.tags.iter().all(|tag| tag.iterations == 1 && tag.particles < 100), "a block of the first round");
    // Refinement is not what is saved.
    let valid = hurried.tags.iter().filter(|tag| tag.valid).count();
    assert!(valid * 10 >= walk().frames() * 9, "{valid} of {}", walk().frames());
}

#[test]
fn particles_and_rounds_are_as_many_as_needed() {
    let room = Room::with_walk();
    let all = room.replay("log.mcap --set filter.adaptive=false");
    assert!(all.tags.iter().all(|tag| (tag.particles, tag.iterations) == (800, 5)));
    let adaptive = &walk().tags;
    let mean = |of: fn(&realitysim::ros2::messages::FrameTag) -> u32| {
        adaptive.iter().map(|tag| f64::from(of(tag))).sum::<f64>() / adaptive.len() as f64
    };
    let (particles, weighed) = (mean(|tag| tag.particles), mean(|tag| tag.weighed));
    println!("adaptive: {particles:.0} particles in the last round, {weighed:.0} weighed a frame; fixed: 800, 4000");
    assert!(adaptive.iter().all(|tag| (100..=800).contains(&tag.particles) && tag.iterations <= 5 && !tag.capped));
    assert!(weighed < 2000.0);
    // What is saved is not paid in accuracy: both are refined to the same pose.
    let apart = super::support::farthest_apart(adaptive, &all.tags);
    assert!(apart < 0.01, "{apart} m apart");
}
