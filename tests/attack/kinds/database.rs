//! The files of an image database, damaged with and without a right checksum, and views from it.

use std::fs;

use glam::DVec3;
use realitysim::config::Settings;
use realitysim::database::{ImageDatabase, Index, ViewQuery, coverage};
use realitysim::geometry::{Euler, Isometry};
use realitysim::views::Method;

use crate::case::{Case, Class, Finding, Outcome, Taken};
use crate::judge::files;
use crate::{bytes, text};

/// Magic and version, then a checksum of everything behind the header.
const CHECKSUM: usize = 12;
const HEADER: usize = 24;

pub fn run(case: &mut Case) -> Outcome {
    let sound = case.walks.database();
    let folder = case.path("db");
    fs::create_dir_all(&folder).expect("the case's folder can be written");
    for file in fs::read_dir(sound).expect("a database").flatten().filter(|entry| entry.path().is_file()) {
        fs::copy(file.path(), folder.join(file.file_name())).expect("copied");
    }
    let index = files(&folder, "bin").pop().expect("an index");
    let was = fs::read(&index).expect("an index");
    let mut changed = was.clone();
    match case.draw.below(5) {
        0 => {
            let path = folder.join("database.json");
            let contents = fs::read_to_string(&path).expect("a database");
            fs::write(&path, text::damage(&mut case.draw, &contents)).expect("written");
            case.tell("text of database.json");
        }
        1 => {
            bytes::damage(&mut case.draw, &mut changed);
            case.tell("bytes of the index");
        }
        _ => {
            for _ in 0..*case.draw.one_of(&[1, 3, 30]) {
                let from = HEADER * usize::from(case.draw.chance(0.9));
                bytes::number(&mut case.draw, &mut changed[from..], true);
            }
            case.tell("numbers of the index");
            if case.draw.chance(0.7) {
                let checksum = crc32fast::hash(&changed[HEADER..]).to_le_bytes();
                changed[CHECKSUM..CHECKSUM + 4].copy_from_slice(&checksum);
                case.tell("with a right checksum");
            }
        }
    }
    fs::write(&index, &changed).expect("written");
    let checksum_is_right =
        changed.len() >= HEADER && crc32fast::hash(&changed[HEADER..]).to_le_bytes() == changed[CHECKSUM..CHECKSUM + 4];
    if Index::open(&index).is_ok() && !checksum_is_right {
        return Err(Finding::new(Class::Silent, "an index with a wrong checksum is opened"));
    }
    let Ok(database) = ImageDatabase::open(&folder, &Settings::default().views) else { return Ok(Taken::Refused) };
    if !checksum_is_right {
        // A record's own checksum is that of its image, and says nothing of the pose beside it.
        return Err(Finding::new(Class::Silent, "views are made from an index with a wrong checksum"));
    }
    let draw = &mut case.draw;
    let mut any = false;
    for method in [Method::Exact, Method::Paper, Method::Nearest] {
        let at = DVec3::new(draw.between(-2.2, -1.6), draw.between(-0.1, 0.3), 0.49);
        let euler = Euler { yaw: draw.between(-0.3, 0.5), pitch: 0.3, roll: 0.0 };
        let wanted = ViewQuery {
            map_from_link: Isometry::from_euler(euler, at),
            method,
            camera: None,
            max_distance_m: f64::INFINITY,
            may_be_stored: draw.chance(0.5),
            without: Vec::new(),
        };
        let Ok(shown) = database.view(&wanted) else { continue };
        any = true;
        let answer = &shown.answer;
        let numbers = [answer.valid_share, answer.sure_share, answer.expected_error_px];
        let of_sources = answer.sources.iter().flat_map(|source| [source.distance_m, source.angle_rad, source.share]);
        if let Some(wild) = numbers.into_iter().chain(of_sources).find(|value| !value.is_finite()) {
            return Err(Finding::new(Class::NotFinite, format!("a view by {method:?} says {wild} of itself")));
        }
    }
    let _ = coverage(database.index(), database.field(), 0.5, 8);
    Ok(if any { Taken::Accepted } else { Taken::Refused })
}
