//! One Arrow file of ours: written batch by batch, read by mapping it into memory without copying.

use super::parquet_file::contained;
use super::schema::TableSchema;
use super::{Error, Result};
use crate::files::{AtomicFile, FileStamp};
use arrow::array::RecordBatch;
use arrow::buffer::Buffer;
use arrow::datatypes::SchemaRef;
use arrow::error::ArrowError;
use arrow::ipc::convert::try_fb_to_schema;
use arrow::ipc::reader::{FileDecoder, read_footer_length};
use arrow::ipc::writer::FileWriter;
use arrow::ipc::{Block, MetadataVersion, root_as_footer};
use fs_err as fs;
use memmap2::Mmap;
use std::path::{Path, PathBuf};
use std::ptr::NonNull;
use std::sync::Arc;

/// Length of the magic at either end of a file.
const MAGIC_LEN: usize = 6;
/// Length of the trailer after the footer: the footer's length and the magic.
const TRAILER_LEN: usize = 4 + MAGIC_LEN;

/// Writes one table.
pub(crate) struct IpcFile {
    path: PathBuf,
    writer: FileWriter<AtomicFile>,
}

impl IpcFile {
    /// Begins a file of this table.
    pub(crate) fn create(path: &Path, table: &TableSchema) -> Result<Self> {
        let file = AtomicFile::create(path)?;
        let writer = FileWriter::try_new(file, &table.arrow()).map_err(failed(path))?;
        Ok(Self { path: path.to_owned(), writer })
    }

    /// Adds rows.
    pub(crate) fn write(&mut self, batch: &RecordBatch) -> Result<()> {
        self.writer.write(batch).map_err(failed(&self.path))
    }

    /// Writes the footer and gives the file its name.
    pub(crate) fn finish(self) -> Result<FileStamp> {
        let file = self.writer.into_inner().map_err(failed(&self.path))?;
        Ok(file.commit()?)
    }
}

/// A table that is mapped into memory. Batches are decoded on demand: their buffers stay in the mapping, but the arrays
/// around them take kilobytes a batch.
pub(crate) struct MappedTable {
    path: PathBuf,
    buffer: Buffer,
    schema: SchemaRef,
    version: MetadataVersion,
    blocks: Vec<Block>,
}

impl MappedTable {
    pub(crate) fn open(path: &Path, table: &TableSchema, stamp: &FileStamp) -> Result<Self> {
        let buffer = map_file(path)?;
        // The checksum comes first: if it matches, the content is as it was written.
        stamp.verify(path, &buffer)?;
        contained(path, || Self::with_footer(path, table, buffer))
    }

    fn with_footer(path: &Path, table: &TableSchema, buffer: Buffer) -> Result<Self> {
        let damaged = |detail: &str| Error::corrupt(path, detail);
        let unreadable = |error: ArrowError| Error::corrupt(path, error.to_string());
        let trailer_start = buffer.len().checked_sub(TRAILER_LEN).ok_or_else(|| damaged("it is too short"))?;
        let mut trailer = [0; TRAILER_LEN];
        trailer.copy_from_slice(&buffer[trailer_start..]);
        let footer_len = read_footer_length(trailer).map_err(unreadable)?;
        let footer_start = trailer_start.checked_sub(footer_len).ok_or_else(|| damaged("its footer is too long"))?;
        let footer = root_as_footer(&buffer[footer_start..trailer_start])
            .map_err(|error| damaged(&format!("its footer cannot be read: {error}")))?;

        let schema = footer.schema().ok_or_else(|| damaged("it has no schema"))?;
        let schema = Arc::new(try_fb_to_schema(schema).map_err(unreadable)?);
        table.check(path, &schema)?;
        let blocks = footer.recordBatches().into_iter().flatten().copied().collect();
        Ok(Self { path: path.to_owned(), version: footer.version(), buffer, schema, blocks })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Shares the schema of `other` if it is equal: with its descriptions, a schema takes tens of kilobytes.
    pub(crate) fn share_schema(&mut self, other: &Self) {
        if self.schema == other.schema {
            self.schema = Arc::clone(&other.schema);
        }
    }

    pub(crate) const fn n_batches(&self) -> usize {
        self.blocks.len()
    }

    /// Decodes the batch at `position`, which must be below [`n_batches`](Self::n_batches), without copying its
    /// content.
    pub(crate) fn batch(&self, position: usize) -> Result<RecordBatch> {
        let damaged = |detail: &str| Error::corrupt(&self.path, detail);
        let block = &self.blocks[position];
        let content = block_of(&self.buffer, block).ok_or_else(|| damaged("a batch lies outside of it"))?;
        let decoder = FileDecoder::new(Arc::clone(&self.schema), self.version).with_require_alignment(true);
        let decoded = contained(&self.path, || Ok(decoder.read_record_batch(block, &content)))?;
        decoded.map_err(|error| damaged(&error.to_string()))?.ok_or_else(|| damaged("a batch has no content"))
    }

    /// Decodes the batches, one after the other.
    pub(crate) fn batches(&self) -> impl Iterator<Item = Result<RecordBatch>> {
        (0..self.n_batches()).map(|position| self.batch(position))
    }
}

/// The bytes of a block, without copying; `None` if it is not within the file.
fn block_of(buffer: &Buffer, block: &Block) -> Option<Buffer> {
    let start = usize::try_from(block.offset()).ok()?;
    let head = usize::try_from(block.metaDataLength()).ok()?;
    let len = head.checked_add(usize::try_from(block.bodyLength()).ok()?)?;
    (start.checked_add(len)? <= buffer.len()).then(|| buffer.slice_with_length(start, len))
}

/// The content of a file as a buffer that keeps the mapping alive.
#[expect(unsafe_code, reason = "mapping a file is the only way to share it with the page cache")]
fn map_file(path: &Path) -> Result<Buffer> {
    let file = fs::File::open(path)?;
    if file.metadata()?.len() == 0 {
        return Err(Error::corrupt(path, "it is empty"));
    }
    // SAFETY: the mapping is private and never written to. Our files are replaced by renaming and never changed in
    // place, so mapped bytes do not change unless another program tampers with them.
    let mapping = unsafe { Mmap::map(file.file()) }
        .map_err(|error| std::io::Error::new(error.kind(), format!("cannot map {}: {error}", path.display())))?;
    let len = mapping.len();
    let start = NonNull::from(&mapping[..]).cast::<u8>();
    // SAFETY: `start` points to `len` bytes that live as long as `mapping`, which the buffer owns.
    Ok(unsafe { Buffer::from_custom_allocation(start, len, Arc::new(mapping)) })
}

/// Arrow wraps the errors of its writer; a full disk should read as a full disk.
fn failed(path: &Path) -> impl FnOnce(ArrowError) -> Error {
    let path = path.to_owned();
    move |error| match error {
        ArrowError::IoError(_, source) => Error::Io(source),
        source => Error::Arrow { path, source },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::MapId;
    use crate::store::tables::lane;

    #[test]
    fn what_a_checksum_does_not_tell_is_an_error_and_no_panic() {
        let dir = tempfile::tempdir().unwrap();
        let (path, table) = (dir.path().join("maps.arrow"), lane::schema());
        let batch = lane::encode(&[(&MapId::from("PIT"), &crate::store::testing::map(1, 2))]).unwrap();
        let mut file = IpcFile::create(&path, &table).unwrap();
        file.write(&batch).unwrap();
        let stamp = file.finish().unwrap();
        let read = |path: &Path, stamp: &FileStamp| -> Result<Vec<RecordBatch>> {
            MappedTable::open(path, &table, stamp)?.batches().collect()
        };
        assert_eq!(read(&path, &stamp).unwrap(), [batch]);
        let whole = fs::read(&path).unwrap();
        let mut n_refused = 0;
        for at in (0..whole.len()).step_by(5) {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x7f;
            let other = dir.path().join("other.arrow");
            fs::write(&other, &damaged).unwrap();
            n_refused += usize::from(read(&other, &FileStamp::of(&damaged)).is_err());
        }
        assert!(n_refused > 100, "{n_refused} changes were noticed");
    }
}
