//! Which segments may be deleted to make room, and in which order.
//!
//! The recorder and `sessions prune` share this policy. It is pure: no file, no clock.

use super::acknowledgement::receivers_of;
use super::manifest::ManifestLine;
use super::sessions::Session;

/// A session, and those of its segments that may be deleted.
#[derive(Clone, Debug)]
pub struct Releasable<'a> {
    /// The session.
    pub session: &'a Session,
    /// Segments that lie here as they were written and that another store has, each with the receiver that has it.
    pub segments: Vec<(&'a ManifestLine, &'a str)>,
}

/// Orders sessions for deletion, oldest first and pinned ones last, and lists their segments that another store has.
///
/// `own` is this folder's own name as a receiver. Its acknowledgement does not count, since it stands for the very
/// copy that would be deleted. The acknowledgement of the folder that received the session does not count either, if
/// the session was moved here from there. If the session was received and these names are unknown, no acknowledgement
/// counts: one of them may be this folder's own.
pub fn releasable<'a>(sessions: impl IntoIterator<Item = &'a Session>, own: Option<&'a str>) -> Vec<Releasable<'a>> {
    let mut order: Vec<&Session> = sessions.into_iter().collect();
    order.sort_by(|a, b| (a.pinned, &a.head.started, &a.name).cmp(&(b.pinned, &b.head.started, &b.name)));
    let of = |session: &'a Session| {
        let received_by = session.received.as_ref().map(|received| received.receiver.as_str());
        let tells_own = own.is_some() && received_by != Some("") || session.received.is_none();
        let here = session.lines.iter().filter(|line| tells_own && session.has(line));
        let with_holder = here.filter_map(|line| {
            let mut holders = receivers_of(line, &session.acknowledged);
            Some((line, holders.find(|holder| Some(*holder) != own && Some(*holder) != received_by)?))
        });
        Releasable { session, segments: with_holder.collect() }
    };
    order.into_iter().map(of).collect()
}
