//! Keeps account of the connections and of answers that clients have not taken yet, and closes connections to make room.
//!
//! The number of connections and the memory of answers are bounded for all clients together. No client can keep others out: a
//! new client takes the place of a connection without a request, and a new answer takes the memory of the slowest reader's.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use hyper::body::Bytes;
use tokio::sync::Notify;

/// Largest number of connections at one time.
const MAX_CONNECTIONS: usize = 256;
/// Largest number of connections from one network. Loopback has no limit of its own, since all programs of this machine share it.
const MAX_PER_ADDRESS: usize = 64;
/// Largest size of all answers that clients have not taken yet, bytes: sixteen of the largest views.
const MAX_UNSENT_BYTES: usize = 256 << 20;
/// Time before which no reader counts as slow.
const MIN_READING_TIME: Duration = Duration::from_secs(1);
/// Time that a new connection has for its first request before its place may be taken: the request may be on its way, and in a
/// crowd the kernel repeats what it dropped after one second.
const MIN_SILENCE: Duration = Duration::from_secs(3);

/// All connections of the service.
#[derive(Default)]
pub(super) struct Connections(Mutex<Table>);

#[derive(Default)]
struct Table {
    /// Connections by number, the oldest first.
    peers: BTreeMap<u64, Peer>,
    /// Number of the next connection.
    next: u64,
    /// Size of all answers that were not taken yet.
    unsent_bytes: usize,
}

/// One connection.
struct Peer {
    network: Network,
    /// Time at which it was admitted.
    came: Instant,
    /// Whether it has ever made a request.
    has_asked: bool,
    /// Number of requests that are not answered to the end.
    requests: usize,
    /// Size of its answers that were not taken yet.
    unsent_bytes: usize,
    /// Time at which the first of its unsent bytes were made.
    reading_since: Instant,
    /// Bytes that it has taken since then.
    taken_bytes: u64,
    /// Tells its task that the connection is to be closed.
    gone: Arc<Notify>,
}

/// A network within which one client may have many addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Network {
    ThisMachine,
    V4([u8; 4]),
    /// The first 64 bits of the address.
    V6([u16; 4]),
}

/// The place of one connection; it becomes free when this is dropped.
pub(super) struct ConnectionSlot {
    connections: Arc<Connections>,
    number: u64,
    gone: Arc<Notify>,
}

/// A request that counts as active while this is held.
pub(super) struct ActiveRequest(Arc<ConnectionSlot>);

/// Bytes of an answer that a client has not taken yet.
struct Unsent {
    bytes: Vec<u8>,
    slot: Arc<ConnectionSlot>,
}

impl Connections {
    /// Gives a new connection a place; `None` if every place is taken by a connection with a request or an unsent answer, or by one
    /// that is as new.
    pub(super) fn admit(self: &Arc<Self>, address: IpAddr) -> Option<Arc<ConnectionSlot>> {
        let (network, now) = (Network::of(address), Instant::now());
        let mut table = self.table();
        let of_network = table.peers.values().filter(|peer| peer.network == network).count();
        let is_crowd = network != Network::ThisMachine && of_network >= MAX_PER_ADDRESS;
        if is_crowd || table.peers.len() >= MAX_CONNECTIONS {
            let idlest = table.find_idlest(is_crowd.then_some(network), now)?;
            table.disconnect(idlest);
        }
        let number = table.next;
        table.next += 1;
        let gone = Arc::new(Notify::new());
        let peer = Peer {
            network,
            came: now,
            has_asked: false,
            requests: 0,
            unsent_bytes: 0,
            reading_since: now,
            taken_bytes: 0,
            gone: Arc::clone(&gone),
        };
        table.peers.insert(number, peer);
        Some(Arc::new(ConnectionSlot { connections: Arc::clone(self), number, gone }))
    }

    /// Returns the number of connections.
    pub(super) fn len(&self) -> usize {
        self.table().peers.len()
    }

    /// Returns the size of all answers that were not taken yet, bytes.
    pub(super) fn unsent_bytes(&self) -> usize {
        self.table().unsent_bytes
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Table {
    /// Finds the connection that its client needs least, of one network or of all.
    ///
    /// It has no request and no unsent answer, and had time for a request; of these, it is the oldest one of the network with the most
    /// connections.
    fn find_idlest(&self, of: Option<Network>, now: Instant) -> Option<u64> {
        let mut counts: BTreeMap<Network, usize> = BTreeMap::new();
        for peer in self.peers.values() {
            *counts.entry(peer.network).or_insert(0) += 1;
        }
        let idle = self.peers.iter().filter(|(_, peer)| peer.is_idle(now));
        let idle = idle.filter(|(_, peer)| of.is_none_or(|network| peer.network == network));
        let first = idle.max_by_key(|(number, peer)| (counts.get(&peer.network), core::cmp::Reverse(**number)));
        first.map(|(number, _)| *number)
    }

    /// Finds the connection that has taken its answers at the lowest rate.
    fn find_slowest(&self, now: Instant) -> Option<u64> {
        let rate = |peer: &Peer| peer.taken_bytes as f64 / (now - peer.reading_since).as_secs_f64();
        let readers = self.peers.iter().filter(|(_, peer)| peer.unsent_bytes > 0);
        let readers = readers.filter(|(_, peer)| now.saturating_duration_since(peer.reading_since) > MIN_READING_TIME);
        let slowest = readers.min_by(|(_, a), (_, b)| rate(a).total_cmp(&rate(b)));
        slowest.map(|(number, _)| *number)
    }

    /// Removes a connection. Its place and its share of the budget are free at once, its memory when its task has ended.
    fn disconnect(&mut self, number: u64) {
        if let Some(peer) = self.peers.remove(&number) {
            self.unsent_bytes -= peer.unsent_bytes;
            peer.gone.notify_one();
        }
    }
}

impl Peer {
    /// Whether it has nothing to wait for, and no first request on its way.
    fn is_idle(&self, now: Instant) -> bool {
        let may_ask_yet = !self.has_asked && now.saturating_duration_since(self.came) < MIN_SILENCE;
        self.requests == 0 && self.unsent_bytes == 0 && !may_ask_yet
    }
}

impl ConnectionSlot {
    /// Begins a request.
    pub(super) fn request(self: &Arc<Self>) -> ActiveRequest {
        if let Some(peer) = self.connections.table().peers.get_mut(&self.number) {
            peer.requests += 1;
            peer.has_asked = true;
        }
        ActiveRequest(Arc::clone(self))
    }

    /// Counts an answer until its client has taken it.
    ///
    /// If the budget of all answers is used up, slow readers are disconnected. `Err` returns the bytes if there are none.
    pub(super) fn hold(self: &Arc<Self>, bytes: Vec<u8>) -> Result<Bytes, Vec<u8>> {
        let mut table = self.connections.table();
        let now = Instant::now();
        while table.unsent_bytes + bytes.len() > MAX_UNSENT_BYTES {
            let Some(slowest) = table.find_slowest(now) else { return Err(bytes) };
            table.disconnect(slowest);
        }
        // A connection that was removed meanwhile takes none of it.
        if let Some(peer) = table.peers.get_mut(&self.number) {
            if peer.unsent_bytes == 0 {
                (peer.reading_since, peer.taken_bytes) = (now, 0);
            }
            peer.unsent_bytes += bytes.len();
            table.unsent_bytes += bytes.len();
        }
        Ok(Bytes::from_owner(Unsent { bytes, slot: Arc::clone(self) }))
    }

    /// Counts bytes that the client has taken.
    pub(super) fn record_taken(&self, bytes: usize) {
        if let Some(peer) = self.connections.table().peers.get_mut(&self.number) {
            peer.taken_bytes += bytes as u64;
        }
    }

    /// Waits until the connection is to be closed, because its place is needed.
    pub(super) async fn disconnected(&self) {
        self.gone.notified().await;
    }
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        self.connections.table().disconnect(self.number);
    }
}

impl Drop for ActiveRequest {
    fn drop(&mut self) {
        if let Some(peer) = self.0.connections.table().peers.get_mut(&self.0.number) {
            peer.requests -= 1;
        }
    }
}

impl AsRef<[u8]> for Unsent {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for Unsent {
    fn drop(&mut self) {
        let mut table = self.slot.connections.table();
        if let Some(peer) = table.peers.get_mut(&self.slot.number) {
            peer.unsent_bytes -= self.bytes.len();
            table.unsent_bytes -= self.bytes.len();
        }
    }
}

impl Network {
    fn of(address: IpAddr) -> Self {
        match address.to_canonical() {
            address if address.is_loopback() => Self::ThisMachine,
            IpAddr::V4(address) => Self::V4(address.octets()),
            IpAddr::V6(address) => {
                let [a, b, c, d, ..] = address.segments();
                Self::V6([a, b, c, d])
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_away(slot: &ConnectionSlot) -> bool {
        !slot.connections.table().peers.contains_key(&slot.number)
    }

    /// Lets all connections be silent for longer than a first request may take.
    fn age(connections: &Connections) {
        for peer in connections.table().peers.values_mut() {
            peer.came -= 2 * MIN_SILENCE;
        }
    }

    fn address(number: u8) -> IpAddr {
        [192, 168, 0, number].into()
    }

    const HERE: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    #[test]
    fn a_newcomer_takes_the_place_of_the_oldest_idle_connection() {
        let connections = Arc::<Connections>::default();
        let slots: Vec<_> = (0..MAX_CONNECTIONS).map(|_| connections.admit(HERE).expect("a place")).collect();
        let asked: Vec<_> = slots[..2].iter().map(ConnectionSlot::request).collect();
        assert!(connections.admit(HERE).is_none(), "their first requests may be on their way");
        age(&connections);
        let newcomer = connections.admit(HERE).expect("a place");
        let away: Vec<usize> = (0..slots.len()).filter(|i| is_away(&slots[*i])).collect();
        assert_eq!((away, connections.len()), (vec![2], MAX_CONNECTIONS));
        drop(asked);
        let another = connections.admit(HERE).expect("a place");
        assert!(is_away(&slots[0]) && !is_away(&newcomer) && !is_away(&another));
        drop(slots);
        assert_eq!(connections.len(), 2, "who leaves is counted once");
    }

    #[test]
    fn nobody_is_sent_away_who_waits_for_an_answer() {
        let connections = Arc::<Connections>::default();
        let slots: Vec<_> = (0..MAX_CONNECTIONS).map(|_| connections.admit(HERE).expect("a place")).collect();
        let asked: Vec<_> = slots.iter().map(ConnectionSlot::request).collect();
        assert!(connections.admit(HERE).is_none());
        let held = slots[7].hold(vec![0; 10]).expect("room");
        drop(asked);
        age(&connections);
        let _newcomers: Vec<_> = (0..MAX_CONNECTIONS - 1).map(|_| connections.admit(HERE).expect("a place")).collect();
        assert!(!is_away(&slots[7]) && connections.len() == MAX_CONNECTIONS, "it has not taken all of its answer");
        drop(held);
        connections.admit(HERE).expect("a place");
        assert!(is_away(&slots[7]));
    }

    #[test]
    fn one_address_has_its_share_and_loses_its_own_connections_first() {
        let connections = Arc::<Connections>::default();
        let many: Vec<_> = (0..MAX_PER_ADDRESS).map(|_| connections.admit(address(1)).expect("a place")).collect();
        age(&connections);
        let other = connections.admit(address(2)).expect("a place");
        let one_more = connections.admit(address(1)).expect("a place");
        assert!(is_away(&many[0]) && !is_away(&other) && !is_away(&one_more));
        let asked: Vec<_> = many[1..].iter().chain([&one_more]).map(ConnectionSlot::request).collect();
        assert!(connections.admit(address(1)).is_none(), "all of its own are at work");
        connections.admit(address(3)).expect("a place");
        drop(asked);
        let mapped: IpAddr = "::ffff:192.168.0.1".parse().expect("an address");
        assert_eq!(Network::of(mapped), Network::of(address(1)));
        let [a, b] = ["2001:db8:1:2::1", "2001:db8:1:2:ffff::9"].map(|text| Network::of(text.parse().expect("one")));
        assert!(a == b && a != Network::of("2001:db8:1:3::1".parse().expect("one")));
    }

    #[test]
    fn answers_have_a_budget_and_the_slowest_reader_loses_its_own() {
        let connections = Arc::<Connections>::default();
        let [slow, slower, fresh] = [0; 3].map(|_| connections.admit(HERE).expect("a place"));
        let half = || vec![0; MAX_UNSENT_BYTES / 2];
        let (first, second) = (slow.hold(half()).expect("room"), slower.hold(half()).expect("room"));
        assert_eq!(connections.unsent_bytes(), MAX_UNSENT_BYTES);
        assert!(fresh.hold(vec![0; 1]).is_err(), "both have only begun to read");
        for peer in connections.table().peers.values_mut() {
            peer.reading_since -= 3 * MIN_READING_TIME;
        }
        slow.record_taken(1000);
        let third = fresh.hold(half()).expect("room");
        assert!(is_away(&slower) && !is_away(&slow));
        assert_eq!(connections.unsent_bytes(), MAX_UNSENT_BYTES);
        drop((first, second, third));
        assert_eq!(connections.unsent_bytes(), 0, "what was sent away is counted once");
    }
}
