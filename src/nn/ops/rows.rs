//! The rows of a matrix that take part in an operation, shared among threads without work on padding.

use std::borrow::Cow;

/// Numbers of the rows where `mask` is not 0, in order.
pub(super) fn valid_rows(mask: &[f32]) -> Vec<u32> {
    (0u32..).zip(mask).filter(|(_, m)| **m != 0.0).map(|(row, _)| row).collect()
}

/// The `rows` (ascending) of a matrix of rows of `width`: a slice of it when they follow each other, otherwise a copy.
pub(super) fn gather<'a>(data: &'a [f32], width: usize, rows: &[u32]) -> Cow<'a, [f32]> {
    match rows {
        [] => Cow::Borrowed(&[]),
        [first, .., last] if (last - first) as usize + 1 == rows.len() => {
            Cow::Borrowed(&data[*first as usize * width..(*last as usize + 1) * width])
        }
        _ => {
            let mut packed = Vec::with_capacity(rows.len() * width);
            for row in rows {
                packed.extend_from_slice(&data[*row as usize * width..][..width]);
            }
            Cow::Owned(packed)
        }
    }
}

/// Some rows of a matrix to be written, with the part of the matrix that holds them.
pub(super) struct Span<'a, 'b> {
    /// Their numbers, ascending.
    pub(super) rows: &'a [u32],
    /// The matrix from the first of these rows to the last.
    values: &'b mut [f32],
    width: usize,
}

impl Span<'_, '_> {
    /// Writes the rows: `write` fills them as a row-major matrix.
    pub(super) fn write(&mut self, write: impl FnOnce(&mut [f32])) {
        let n = self.rows.len() * self.width;
        if self.values.len() == n {
            return write(self.values);
        }
        let mut packed = vec![0.0; n];
        write(&mut packed);
        for (row, packed) in self.rows.iter().zip(packed.chunks_exact(self.width)) {
            let start = (row - self.rows[0]) as usize * self.width;
            self.values[start..start + self.width].copy_from_slice(packed);
        }
    }
}

/// Splits a matrix of rows of `width` into spans of `n` of the given `rows` (ascending). The split does not depend on
/// the number of threads, and neither do results.
pub(super) fn spans<'a, 'b>(mut values: &'b mut [f32], width: usize, rows: &'a [u32], n: usize) -> Vec<Span<'a, 'b>> {
    let mut spans = Vec::with_capacity(rows.len().div_ceil(n));
    let mut start = 0;
    for rows in rows.chunks(n) {
        let (first, end) = (rows[0] as usize, rows[rows.len() - 1] as usize + 1);
        let (_, rest) = values.split_at_mut((first - start) * width);
        let (span, rest) = rest.split_at_mut((end - first) * width);
        spans.push(Span { rows, values: span, width });
        values = rest;
        start = end;
    }
    spans
}

/// The `rows` (each at most once, in any order) of a matrix of rows of `width`, to be written.
pub(super) fn pick_mut<'a>(values: &'a mut [f32], width: usize, rows: &[u32]) -> Vec<&'a mut [f32]> {
    let mut all: Vec<&mut [f32]> = values.chunks_exact_mut(width).collect();
    rows.iter().map(|row| std::mem::take(&mut all[*row as usize])).collect()
}

/// Splits `values` into parts of the given lengths.
pub(super) fn split_mut<'a, T>(mut values: &'a mut [T], lengths: &[usize]) -> Vec<&'a mut [T]> {
    let mut parts = Vec::with_capacity(lengths.len());
    for n in lengths {
        let (part, rest) = values.split_at_mut(*n);
        parts.push(part);
        values = rest;
    }
    parts
}

/// Splits `values` into parts of the given lengths.
pub(super) fn split<'a, T>(mut values: &'a [T], lengths: &[usize]) -> Vec<&'a [T]> {
    let mut parts = Vec::with_capacity(lengths.len());
    for n in lengths {
        let (part, rest) = values.split_at(*n);
        parts.push(part);
        values = rest;
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_write_the_given_rows_and_no_others() {
        let rows = valid_rows(&[0.0, 1.0, 1.0, 0.0, 1.0, 1.0]);
        assert_eq!(rows, [1, 2, 4, 5]);
        let data: Vec<f32> = (0..12).map(|i| i as f32).collect();
        assert!(matches!(gather(&data, 2, &rows[..2]), Cow::Borrowed([2.0, 3.0, 4.0, 5.0])));
        assert_eq!(gather(&data, 2, &rows[1..3]).as_ref(), [4.0, 5.0, 8.0, 9.0]);
        for n in 1..=4 {
            let mut copy = vec![-1.0; 12];
            for mut span in spans(&mut copy, 2, &rows, n) {
                let values = gather(&data, 2, span.rows);
                span.write(|target| target.copy_from_slice(&values));
            }
            assert_eq!(copy, [-1.0, -1.0, 2.0, 3.0, 4.0, 5.0, -1.0, -1.0, 8.0, 9.0, 10.0, 11.0], "{n}");
        }
    }
}
