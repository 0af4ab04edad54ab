//! What may a command write, and what may it remove? Whole files, lists of our own files, locks, and overlaps.
//!
//! The rule: a command removes only files that a list of ours names. It refuses an output that overlaps an input or
//! holds foreign files before it touches anything.
//!
//! `AtomicFile` writes next to its target under a name that no other process uses; a `NewFolder` appears complete or
//! not at all; `regular` rejects anything other than files and folders before it is opened.

mod as_text;
mod atomic;
mod error;
mod exchange;
mod lock;
mod names;
mod new_folder;
mod overlap;
mod regular;
#[cfg(test)]
mod tests;
mod written;

pub use as_text::{for_shell, path_as_text, paths_as_text};
pub use atomic::{
    AtomicFile, FileStamp, PARTIAL_SUFFIX, is_partial_of, link_or_copy, remove_if_present, unique_partial,
    write_atomically,
};
pub use error::{Error, PathRelation, Result};
pub use exchange::exchange;
pub use lock::{LOCK_FILE, Lock};
pub use names::{call, in_their_names};
pub use new_folder::{NewFolder, check_free};
pub use overlap::{check_overlap, resolve};
pub use regular::regular;
pub use written::{
    LIST_FILE, clear, enter_all, files_below, foreign, is_link, keep_list, list_above, listed, remove_leftovers,
    remove_listed, stays_below, sync_folder,
};
