//! Bounds the connections to the control socket so that no client can keep others out.

use std::collections::BTreeMap;
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Connections that can be open at one time.
const MAX_ASKERS: usize = 16;
/// Connections that may listen to poses; the rest are kept for commands.
const MAX_LISTENERS: usize = 12;

/// The open connections, shared by their threads.
#[derive(Default)]
pub(super) struct Clients(Mutex<Table>);

#[derive(Default)]
struct Table {
    /// By connection number, so the oldest comes first.
    clients: BTreeMap<u64, Client>,
    next: u64,
}

struct Client {
    stream: Arc<UnixStream>,
    activity: Activity,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Activity {
    Nothing,
    /// One of its commands is being carried out.
    Waiting,
    Listening,
}

/// A connection's slot in the table; dropping it frees the slot.
pub(super) struct ClientSlot {
    clients: Arc<Clients>,
    number: u64,
    pub(super) stream: Arc<UnixStream>,
}

impl Clients {
    /// Gives a slot to a new connection.
    ///
    /// If all slots are taken, the oldest connection without a command under way is closed. If there is none, `Err` returns
    /// the stream and the refusal for its client.
    pub(super) fn admit(self: &Arc<Self>, stream: UnixStream) -> Result<ClientSlot, (UnixStream, String)> {
        let mut table = self.table();
        if table.clients.len() >= MAX_ASKERS {
            let idle = table
                .clients
                .iter()
                .find(|(_, client)| client.activity == Activity::Nothing)
                .map(|(number, _)| *number);
            match idle.and_then(|number| table.clients.remove(&number)) {
                // The shutdown ends that connection's thread.
                Some(client) => drop(client.stream.shutdown(Shutdown::Both)),
                None => return Err((stream, format!("{MAX_ASKERS} others are asking already: try again later"))),
            }
        }
        let (number, stream) = (table.next, Arc::new(stream));
        table.next += 1;
        table.clients.insert(number, Client { stream: Arc::clone(&stream), activity: Activity::Nothing });
        Ok(ClientSlot { clients: Arc::clone(self), number, stream })
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl ClientSlot {
    /// Runs `work` while the connection is marked as waiting, so that its slot is not given to others.
    pub(super) fn while_waiting<T>(&self, work: impl FnOnce() -> T) -> T {
        self.set_activity(Activity::Waiting);
        let done = work();
        self.set_activity(Activity::Nothing);
        done
    }

    /// Marks the connection as listening to poses; `Err` has the refusal if there are too many listeners.
    pub(super) fn start_listening(&self) -> Result<(), String> {
        let mut table = self.clients.table();
        if table.clients.values().filter(|client| client.activity == Activity::Listening).count() >= MAX_LISTENERS {
            return Err(format!("{MAX_LISTENERS} others listen to poses already: try again later"));
        }
        if let Some(client) = table.clients.get_mut(&self.number) {
            client.activity = Activity::Listening;
        }
        Ok(())
    }

    fn set_activity(&self, activity: Activity) {
        if let Some(client) = self.clients.table().clients.get_mut(&self.number) {
            client.activity = activity;
        }
    }
}

impl Drop for ClientSlot {
    fn drop(&mut self) {
        self.clients.table().clients.remove(&self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    /// Both ends of a connection.
    fn pair() -> (UnixStream, UnixStream) {
        UnixStream::pair().expect("two ends")
    }

    #[test]
    fn the_oldest_idle_connection_gives_way() {
        let clients = Arc::<Clients>::default();
        let (mut ends, mut slots) = (Vec::new(), Vec::new());
        for _ in 0..MAX_ASKERS {
            let (end, client) = pair();
            ends.push(end);
            slots.push(clients.admit(client).expect("room"));
        }
        slots[0].set_activity(Activity::Waiting);
        slots[1].start_listening().expect("the only one");
        clients.admit(pair().1).expect("the slot of the third");
        assert_eq!(ends[2].read(&mut [0; 1]).expect("closed"), 0);
        ends[0].set_nonblocking(true).expect("set");
        assert!(ends[0].read(&mut [0; 1]).is_err(), "still open");
        slots.drain(2..);
        assert_eq!(clients.table().clients.len(), 2);
    }

    #[test]
    fn listeners_leave_room_for_orders() {
        let clients = Arc::<Clients>::default();
        let slots: Vec<ClientSlot> = (0..MAX_ASKERS).map(|_| clients.admit(pair().1).expect("room")).collect();
        let listening = slots.iter().filter(|slot| slot.start_listening().is_ok()).count();
        assert_eq!(listening, MAX_LISTENERS);
        let orders = &slots[MAX_LISTENERS..];
        orders.iter().for_each(|slot| slot.set_activity(Activity::Waiting));
        let (_, words) = clients.admit(pair().1).err().expect("all are at work");
        assert!(words.contains("16 others are asking"), "{words}");
        assert_eq!(orders[0].while_waiting(|| 7), 7);
        clients.admit(pair().1).expect("one has got its answer");
    }
}
