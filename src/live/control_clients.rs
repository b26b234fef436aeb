//! The connections to a recorder's socket, of which there are few, so that none of them can keep others out.

use std::collections::BTreeMap;
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Connections at one time.
const MAX_ASKERS: usize = 16;
/// Of them, those that listen to poses; the others are for orders.
const MAX_LISTENERS: usize = 12;

#[derive(Default)]
pub(super) struct Askers(Mutex<Table>);

#[derive(Default)]
struct Table {
    /// By number: the oldest first.
    askers: BTreeMap<u64, Asker>,
    next: u64,
}

struct Asker {
    stream: Arc<UnixStream>,
    doing: Doing,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Doing {
    Nothing,
    /// An order of it is being carried out.
    Waiting,
    Listening,
}

/// One of the connections, until it is dropped.
pub(super) struct Place {
    askers: Arc<Askers>,
    number: u64,
    pub(super) stream: Arc<UnixStream>,
}

impl Askers {
    /// If all are taken, the oldest connection without an order under way is closed for this one. `Err` with the words for it
    /// if there is none.
    pub(super) fn admit(self: &Arc<Self>, stream: UnixStream) -> Result<Place, (UnixStream, String)> {
        let mut table = self.table();
        if table.askers.len() >= MAX_ASKERS {
            let idle = table.askers.iter().find(|(_, asker)| asker.doing == Doing::Nothing).map(|(number, _)| *number);
            match idle.and_then(|number| table.askers.remove(&number)) {
                // Its thread sees the end.
                Some(asker) => drop(asker.stream.shutdown(Shutdown::Both)),
                None => return Err((stream, format!("{MAX_ASKERS} others are asking already: try again later"))),
            }
        }
        let (number, stream) = (table.next, Arc::new(stream));
        table.next += 1;
        table.askers.insert(number, Asker { stream: Arc::clone(&stream), doing: Doing::Nothing });
        Ok(Place { askers: Arc::clone(self), number, stream })
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Place {
    /// While it works, the connection is not given to others.
    pub(super) fn waiting<T>(&self, work: impl FnOnce() -> T) -> T {
        self.becomes(Doing::Waiting);
        let done = work();
        self.becomes(Doing::Nothing);
        done
    }

    /// `Err` with the words for it if there are too many already.
    pub(super) fn listens(&self) -> Result<(), String> {
        let mut table = self.askers.table();
        if table.askers.values().filter(|asker| asker.doing == Doing::Listening).count() >= MAX_LISTENERS {
            return Err(format!("{MAX_LISTENERS} others listen to poses already: try again later"));
        }
        if let Some(asker) = table.askers.get_mut(&self.number) {
            asker.doing = Doing::Listening;
        }
        Ok(())
    }

    fn becomes(&self, doing: Doing) {
        if let Some(asker) = self.askers.table().askers.get_mut(&self.number) {
            asker.doing = doing;
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.askers.table().askers.remove(&self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    /// Both ends.
    fn pair() -> (UnixStream, UnixStream) {
        UnixStream::pair().expect("two ends")
    }

    #[test]
    fn the_oldest_that_asks_nothing_gives_way() {
        let askers = Arc::<Askers>::default();
        let (mut ends, mut places) = (Vec::new(), Vec::new());
        for _ in 0..MAX_ASKERS {
            let (end, asker) = pair();
            ends.push(end);
            places.push(askers.admit(asker).expect("room"));
        }
        places[0].becomes(Doing::Waiting);
        places[1].listens().expect("the only one");
        askers.admit(pair().1).expect("the place of the third");
        assert_eq!(ends[2].read(&mut [0; 1]).expect("closed"), 0);
        ends[0].set_nonblocking(true).expect("set");
        assert!(ends[0].read(&mut [0; 1]).is_err(), "still open");
        places.drain(2..);
        assert_eq!(askers.table().askers.len(), 2);
    }

    #[test]
    fn listeners_leave_room_for_orders() {
        let askers = Arc::<Askers>::default();
        let places: Vec<Place> = (0..MAX_ASKERS).map(|_| askers.admit(pair().1).expect("room")).collect();
        let listening = places.iter().filter(|place| place.listens().is_ok()).count();
        assert_eq!(listening, MAX_LISTENERS);
        let orders = &places[MAX_LISTENERS..];
        orders.iter().for_each(|place| place.becomes(Doing::Waiting));
        let (_, words) = askers.admit(pair().1).err().expect("all are at work");
        assert!(words.contains("16 others are asking"), "{words}");
        assert_eq!(orders[0].waiting(|| 7), 7);
        askers.admit(pair().1).expect("one has got its answer");
    }
}
