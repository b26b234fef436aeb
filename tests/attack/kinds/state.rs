//! What an agent leaves to the next one, damaged with and without a right checksum, and a sound log that begins with it.

use std::fs;

use realitysim::config::Settings;
use realitysim::recording::STATE_FILE;
use realitysim::tagging::Checkpoint;
use realitysim::tagging::checkpoint::VERSION;

use crate::bytes;
use crate::case::{Case, Class, Finding, Outcome, Taken};
use crate::judge::{self, Judge};
use crate::walks::{options, replayed};

/// Magic, version, checksum.
const HEADER: usize = 16;

pub fn run(case: &mut Case) -> Outcome {
    let captures = case.path("captures");
    fs::create_dir_all(&captures).expect("the case's folder can be written");
    let sound = fs::read(case.walks.captures().join(STATE_FILE)).expect("a replay leaves its state");
    let mut state = sound.clone();
    if case.draw.chance(0.3) {
        bytes::damage(&mut case.draw, &mut state);
        case.tell("bytes of the state");
        if state != sound && Checkpoint::decode(&state).is_ok() {
            return Err(Finding::new(Class::Silent, "a state with a wrong checksum is taken"));
        }
    } else {
        let mut body = sound[HEADER..].to_vec();
        for _ in 0..*case.draw.one_of(&[1, 1, 3, 20]) {
            bytes::number(&mut case.draw, &mut body, true);
        }
        if case.draw.chance(0.2) {
            bytes::damage(&mut case.draw, &mut body);
        }
        case.tell("numbers of the state, with a right checksum");
        state = [&sound[..8], &VERSION.to_le_bytes(), &crc32fast::hash(&body).to_le_bytes(), &body].concat();
    }
    let accepted = Checkpoint::decode(&state).is_ok();
    fs::write(captures.join(STATE_FILE), &state).expect("the case's folder can be written");
    let walk = &case.walks.all[if accepted && case.draw.chance(0.3) { 2 } else { 0 }];
    let source = case.write("log.mcap", walk.log());
    let mut options = options(source, captures.clone(), Settings::default());
    options.warm_start = true;
    let report = replayed(&options);
    judge::replay(&report, &captures, Judge { truth: Some(&walk.truth), mirrored: true })?;
    // A robot that starts by itself must record, whatever its last end has left.
    match report {
        Ok(_) if accepted => Ok(Taken::Accepted),
        Ok(_) => Ok(Taken::Refused),
        Err(what) => Err(Finding::new(Class::Starved, format!("nothing is recorded: {what}"))),
    }
}
