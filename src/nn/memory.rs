//! Keeps freed memory of tensors for later ones.

use std::sync::Once;

/// Makes the C library keep freed memory for later tensors instead of returning it to the kernel. A network frees and
/// allocates the same large tensors at every step; without this, 20 to 40 % of the time went into page faults. The
/// process never shrinks afterwards, so call it only for training and sampling. Only glibc on Linux needs it; calls
/// after the first do nothing.
pub fn keep_freed_memory() {
    static ONCE: Once = Once::new();
    ONCE.call_once(set_options);
}

#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn set_options() {
    use std::ffi::c_int;

    // The values of malloc.h.
    const M_TRIM_THRESHOLD: c_int = -1;
    const M_TOP_PAD: c_int = -2;
    const M_MMAP_MAX: c_int = -4;
    #[expect(unsafe_code, reason = "the C library's allocator has no safe interface to its options")]
    // SAFETY: `mallopt` is declared as in malloc.h; it takes plain numbers, locks the allocator while it sets them, and
    // ignores what it cannot use.
    unsafe {
        unsafe extern "C" {
            fn mallopt(option: c_int, value: c_int) -> c_int;
        }
        // Large tensors come from the heap, not from mappings of their own; its free end is never given back (-1: no
        // limit), and it grows by 64 MiB at a time.
        mallopt(M_MMAP_MAX, 0);
        mallopt(M_TRIM_THRESHOLD, -1);
        mallopt(M_TOP_PAD, 1 << 26);
    }
}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn set_options() {}

#[cfg(test)]
mod tests {
    #[test]
    fn memory_is_allocated_as_before() {
        super::keep_freed_memory();
        super::keep_freed_memory();
        for i in 0..4u8 {
            let large = vec![i; 48 << 20];
            assert!(large.iter().all(|v| *v == i));
        }
    }
}
