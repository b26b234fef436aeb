//! Who is connected, what has been made for them and not been taken yet, and who has to go when others need the room.
//!
//! Places and memory are bounded for all clients together, and handed out so that nobody keeps others out by holding them: a new
//! client takes the place of a connection on which nothing is asked, and an answer takes the memory of the slowest reader.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use hyper::body::Bytes;
use tokio::sync::Notify;

/// Connections at one time.
const MAX_CONNECTIONS: usize = 256;
/// Those of one address. Loopback has no limit of its own: all programs of this machine share that address.
const MAX_PER_ADDRESS: usize = 64;
/// Bytes of all answers that have been made and not been taken yet: sixteen of the largest views.
const MAX_UNSENT_BYTES: usize = 256 << 20;
/// So long no reader is told to be slow.
const LEAST_READING: Duration = Duration::from_secs(1);

#[derive(Default)]
pub(super) struct Connections(Mutex<Table>);

#[derive(Default)]
struct Table {
    /// By number: the oldest connection first.
    peers: BTreeMap<u64, Peer>,
    next: u64,
    unsent_bytes: usize,
}

struct Peer {
    network: Network,
    /// Asked, and not answered to the end.
    requests: usize,
    unsent_bytes: usize,
    /// When the first of its unsent bytes were made, and what it has taken since.
    reading_since: Instant,
    taken_bytes: u64,
    gone: Arc<Notify>,
}

/// What one client can have many addresses of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Network {
    ThisMachine,
    V4([u8; 4]),
    /// The first 64 bits.
    V6([u16; 4]),
}

/// A connection's place; free again when it is dropped.
pub(super) struct Seat {
    connections: Arc<Connections>,
    number: u64,
    gone: Arc<Notify>,
}

/// A request under way, for as long as it is held.
pub(super) struct UnderWay(Arc<Seat>);

/// Bytes that wait to be taken by a client.
struct Unsent {
    bytes: Vec<u8>,
    seat: Arc<Seat>,
}

impl Connections {
    /// A place for a new connection; `None` if every place is taken by one on which something is asked.
    pub(super) fn admit(self: &Arc<Self>, address: IpAddr) -> Option<Arc<Seat>> {
        let network = Network::of(address);
        let mut table = self.table();
        let of_network = table.peers.values().filter(|peer| peer.network == network).count();
        let is_crowd = network != Network::ThisMachine && of_network >= MAX_PER_ADDRESS;
        if is_crowd || table.peers.len() >= MAX_CONNECTIONS {
            let idlest = table.idlest(is_crowd.then_some(network))?;
            table.send_away(idlest);
        }
        let number = table.next;
        table.next += 1;
        let gone = Arc::new(Notify::new());
        let peer = Peer {
            network,
            requests: 0,
            unsent_bytes: 0,
            reading_since: Instant::now(),
            taken_bytes: 0,
            gone: Arc::clone(&gone),
        };
        table.peers.insert(number, peer);
        Some(Arc::new(Seat { connections: Arc::clone(self), number, gone }))
    }

    pub(super) fn len(&self) -> usize {
        self.table().peers.len()
    }

    pub(super) fn unsent_bytes(&self) -> usize {
        self.table().unsent_bytes
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Table {
    /// The connection that its client misses least: nothing is asked on it, its network has most of them, and it is the oldest.
    fn idlest(&self, of: Option<Network>) -> Option<u64> {
        let mut counts: BTreeMap<Network, usize> = BTreeMap::new();
        for peer in self.peers.values() {
            *counts.entry(peer.network).or_insert(0) += 1;
        }
        let idle = self.peers.iter().filter(|(_, peer)| peer.requests == 0 && peer.unsent_bytes == 0);
        let idle = idle.filter(|(_, peer)| of.is_none_or(|network| peer.network == network));
        let first = idle.max_by_key(|(number, peer)| (counts.get(&peer.network), core::cmp::Reverse(**number)));
        first.map(|(number, _)| *number)
    }

    /// Who has taken least of its answer in the time it had.
    fn slowest(&self, now: Instant) -> Option<u64> {
        let rate = |peer: &Peer| peer.taken_bytes as f64 / (now - peer.reading_since).as_secs_f64();
        let readers = self.peers.iter().filter(|(_, peer)| peer.unsent_bytes > 0);
        let readers = readers.filter(|(_, peer)| now.saturating_duration_since(peer.reading_since) > LEAST_READING);
        let slowest = readers.min_by(|(_, a), (_, b)| rate(a).total_cmp(&rate(b)));
        slowest.map(|(number, _)| *number)
    }

    /// What it holds is free for others at once, and its memory as soon as its task has been told.
    fn send_away(&mut self, number: u64) {
        if let Some(peer) = self.peers.remove(&number) {
            self.unsent_bytes -= peer.unsent_bytes;
            peer.gone.notify_one();
        }
    }
}

impl Seat {
    pub(super) fn request(self: &Arc<Self>) -> UnderWay {
        if let Some(peer) = self.connections.table().peers.get_mut(&self.number) {
            peer.requests += 1;
        }
        UnderWay(Arc::clone(self))
    }

    /// Counts an answer until its client has taken it. If all answers under way have no room for it, slow readers lose theirs;
    /// `Err` with the same bytes if there are none.
    pub(super) fn hold(self: &Arc<Self>, bytes: Vec<u8>) -> Result<Bytes, Vec<u8>> {
        let mut table = self.connections.table();
        let now = Instant::now();
        while table.unsent_bytes + bytes.len() > MAX_UNSENT_BYTES {
            let Some(slowest) = table.slowest(now) else { return Err(bytes) };
            table.send_away(slowest);
        }
        // Who has been sent away meanwhile takes none of it.
        if let Some(peer) = table.peers.get_mut(&self.number) {
            if peer.unsent_bytes == 0 {
                (peer.reading_since, peer.taken_bytes) = (now, 0);
            }
            peer.unsent_bytes += bytes.len();
            table.unsent_bytes += bytes.len();
        }
        Ok(Bytes::from_owner(Unsent { bytes, seat: Arc::clone(self) }))
    }

    pub(super) fn took(&self, bytes: usize) {
        if let Some(peer) = self.connections.table().peers.get_mut(&self.number) {
            peer.taken_bytes += bytes as u64;
        }
    }

    /// Comes back once the place is needed for others.
    pub(super) async fn sent_away(&self) {
        self.gone.notified().await;
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.connections.table().send_away(self.number);
    }
}

impl Drop for UnderWay {
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
        let mut table = self.seat.connections.table();
        if let Some(peer) = table.peers.get_mut(&self.seat.number) {
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

    fn is_away(seat: &Seat) -> bool {
        !seat.connections.table().peers.contains_key(&seat.number)
    }

    fn address(number: u8) -> IpAddr {
        [192, 168, 0, number].into()
    }

    const HERE: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    #[test]
    fn a_newcomer_takes_the_place_of_the_oldest_connection_on_which_nothing_is_asked() {
        let connections = Arc::<Connections>::default();
        let seats: Vec<_> = (0..MAX_CONNECTIONS).map(|_| connections.admit(HERE).expect("a place")).collect();
        let asked: Vec<_> = seats[..2].iter().map(Seat::request).collect();
        let newcomer = connections.admit(HERE).expect("a place");
        let away: Vec<usize> = (0..seats.len()).filter(|i| is_away(&seats[*i])).collect();
        assert_eq!((away, connections.len()), (vec![2], MAX_CONNECTIONS));
        drop(asked);
        let another = connections.admit(HERE).expect("a place");
        assert!(is_away(&seats[0]) && !is_away(&newcomer) && !is_away(&another));
        drop(seats);
        assert_eq!(connections.len(), 2, "who leaves is counted once");
    }

    #[test]
    fn nobody_is_sent_away_who_waits_for_an_answer() {
        let connections = Arc::<Connections>::default();
        let seats: Vec<_> = (0..MAX_CONNECTIONS).map(|_| connections.admit(HERE).expect("a place")).collect();
        let asked: Vec<_> = seats.iter().map(Seat::request).collect();
        assert!(connections.admit(HERE).is_none());
        let held = seats[7].hold(vec![0; 10]).expect("room");
        drop(asked);
        let _newcomers: Vec<_> = (0..MAX_CONNECTIONS - 1).map(|_| connections.admit(HERE).expect("a place")).collect();
        assert!(!is_away(&seats[7]) && connections.len() == MAX_CONNECTIONS, "it has not taken all of its answer");
        drop(held);
        connections.admit(HERE).expect("a place");
        assert!(is_away(&seats[7]));
    }

    #[test]
    fn one_address_has_its_share_and_loses_its_own_connections_first() {
        let connections = Arc::<Connections>::default();
        let many: Vec<_> = (0..MAX_PER_ADDRESS).map(|_| connections.admit(address(1)).expect("a place")).collect();
        let other = connections.admit(address(2)).expect("a place");
        let one_more = connections.admit(address(1)).expect("a place");
        assert!(is_away(&many[0]) && !is_away(&other) && !is_away(&one_more));
        let asked: Vec<_> = many[1..].iter().chain([&one_more]).map(Seat::request).collect();
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
            peer.reading_since -= 3 * LEAST_READING;
        }
        slow.took(1000);
        let third = fresh.hold(half()).expect("room");
        assert!(is_away(&slower) && !is_away(&slow));
        assert_eq!(connections.unsent_bytes(), MAX_UNSENT_BYTES);
        drop((first, second, third));
        assert_eq!(connections.unsent_bytes(), 0, "what was sent away is counted once");
    }
}
