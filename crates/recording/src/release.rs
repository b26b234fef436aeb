//! What may go to make room, and in which order: the one policy of the recorder and of `sessions prune`. Pure.

use super::acknowledgement::receivers_of;
use super::catalogue::Session;
use super::manifest::ManifestLine;

/// A session, and its segments that lie here as they were written and that another store has, each with its name.
#[derive(Clone, Debug)]
pub struct Releasable<'a> {
    pub session: &'a Session,
    pub segments: Vec<(&'a ManifestLine, &'a str)>,
}

/// Oldest first, pinned last. `own` is this folder's own name as a receiver, whose word does not count: it is what would go.
/// Nor does that of the folder which received the session, if it was moved from there. Where something was received and these
/// names are gone, nobody's word counts: one of them may be this folder's.
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
