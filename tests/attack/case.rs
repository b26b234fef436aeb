//! One case: what is drawn for it, where it may write, and what has become of it.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use crate::draw::Draw;
use crate::walks::Walks;

/// What is wrong with the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// A panic, an abort, a signal.
    Panic,
    /// Longer than a case may take.
    Hang,
    /// More than a gigabyte.
    Memory,
    /// A number that comes out is NaN or infinite, or a tag's covariance is none.
    NotFinite,
    /// A tag is valid, and farther from the truth than it says.
    Wrong,
    /// Damage that a checksum should have shown is taken for sound, or an exit code says that all is well.
    Silent,
    /// A client of the service keeps others from their answers.
    Starved,
}

impl Class {
    pub const ALL: [Self; 7] =
        [Self::Panic, Self::Hang, Self::Memory, Self::NotFinite, Self::Wrong, Self::Silent, Self::Starved];

    pub fn name(self) -> &'static str {
        match self {
            Self::Panic => "panic",
            Self::Hang => "hang",
            Self::Memory => "memory",
            Self::NotFinite => "not_finite",
            Self::Wrong => "valid_and_wrong",
            Self::Silent => "silent",
            Self::Starved => "starved",
        }
    }
}

#[derive(Clone, Debug)]
pub struct Finding {
    pub class: Class,
    pub what: String,
}

impl Finding {
    pub fn new(class: Class, what: impl Display) -> Self {
        Self { class, what: what.to_string() }
    }
}

/// How the program took the input, if nothing is wrong with that.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    Refused,
    Accepted,
}

pub type Outcome = Result<Taken, Finding>;

/// What the cases of one process share, and what one of them draws.
pub struct Case<'a> {
    pub draw: Draw,
    /// Its own, and empty when it begins.
    pub folder: &'a Path,
    pub walks: &'a Walks,
    /// The damage, in words.
    pub story: Vec<String>,
}

impl Case<'_> {
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// A file in the case's folder.
    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, content).expect("the case's folder can be written");
        path
    }

    pub fn tell(&mut self, what: impl Display) {
        self.story.push(what.to_string());
    }
}
