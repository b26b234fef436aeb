//! Removes the Unix socket that a killed process has left behind.

use std::io;
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::UnixStream;
use std::path::Path;

/// Removes a socket on which nobody listens any more. One that is in use stays, and `bind` will fail on it.
///
/// # Errors
/// `AlreadyExists` if there is something else at the path, which is left alone.
pub fn clear_away(path: &Path) -> io::Result<()> {
    let Ok(there) = std::fs::symlink_metadata(path) else { return Ok(()) };
    if !there.file_type().is_socket() {
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, "something is there that is no socket"));
    }
    if UnixStream::connect(path).is_err() {
        let _ = std::fs::remove_file(path);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::net::UnixListener;

    #[test]
    fn only_a_socket_that_nobody_listens_on_goes() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("x");
        clear_away(&path).expect("nothing there");
        std::fs::write(&path, "somebody's").expect("written");
        assert_eq!(clear_away(&path).map_err(|error| error.kind()), Err(io::ErrorKind::AlreadyExists));
        assert_eq!(std::fs::read_to_string(&path).expect("still there"), "somebody's");
        std::fs::remove_file(&path).expect("mine");
        let listener = UnixListener::bind(&path).expect("bound");
        clear_away(&path).expect("in use");
        assert!(path.exists());
        drop(listener);
        clear_away(&path).expect("stale");
        assert!(!path.exists());
    }
}
