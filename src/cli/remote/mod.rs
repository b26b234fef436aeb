//! Addresses of object stores on the command line, in place of paths of captures, databases and files.

#[cfg(feature = "remote")]
mod local_copies;
#[cfg(feature = "remote")]
mod upload;

#[cfg(feature = "remote")]
pub use local_copies::with_local_copies;
#[cfg(feature = "remote")]
pub use upload::run as upload;

/// Without the feature an address is told from a path that is not there.
#[cfg(not(feature = "remote"))]
pub fn with_local_copies(arguments: Vec<std::ffi::OsString>) -> anyhow::Result<Vec<std::ffi::OsString>> {
    let schemes = ["s3://", "s3a://", "gs://", "az://", "abfs://", "abfss://", "https://"];
    let is_address =
        |text: &&str| schemes.iter().any(|scheme| text.starts_with(scheme) || text.contains(&format!("={scheme}")));
    match arguments.iter().filter_map(|argument| argument.to_str()).find(is_address) {
        None => Ok(arguments),
        Some(address) => {
            let what = "this program was built without the feature `remote`, and reads no object stores";
            Err(super::settings::UsageError(format!("{address}: {what}")).into())
        }
    }
}
