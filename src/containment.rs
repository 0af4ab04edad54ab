//! Turns a library's panic over a damaged file into an error, without a message on the terminal.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};

thread_local! {
    static IS_CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// The result of `decode`; `None` if it panicked. Values that `decode` has used must not be used afterwards.
///
/// For decoders of other projects whose assertions a damaged file violates: one such file must not end the reading of
/// all others.
pub fn contained<T>(decode: impl FnOnce() -> T) -> Option<T> {
    let outer = IS_CONTAINED.replace(true);
    let outcome = catch_unwind(AssertUnwindSafe(decode));
    IS_CONTAINED.set(outer);
    outcome.ok()
}

/// Whether this thread is inside of [`contained`], so that a panic will be reported as an error.
pub fn is_contained() -> bool {
    IS_CONTAINED.get()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_contained_and_the_thread_goes_on() {
        assert_eq!(contained(|| 7), Some(7));
        let refused = contained(|| {
            assert!(is_contained());
            assert_eq!(contained(|| 1), Some(1));
            assert!(is_contained());
            Vec::<i32>::new()[usize::from(is_contained())]
        });
        assert_eq!((refused, is_contained()), (None, false));
    }
}
