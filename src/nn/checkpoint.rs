//! Self-describing checkpoint files: tensors and their meaning in one file, complete or absent.

use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::Path;

use candle_core::{Device, Tensor};
use safetensors::{SafeTensors, View};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::error::Error;
use crate::files::{regular, write_atomically};

/// The entry of the safetensors metadata that holds djinn's, as JSON.
const METADATA_KEY: &str = "djinn";

/// The content of a checkpoint file.
#[derive(Debug, Clone)]
pub struct Checkpoint<M> {
    /// Tensors by name.
    pub tensors: BTreeMap<String, Tensor>,
    /// Description of the tensors: the configuration, the normalization, the position in training.
    pub metadata: M,
    /// BLAKE3 hash of the file in hexadecimal digits.
    pub fingerprint: String,
}

/// Writes `tensors` and `metadata` to a safetensors file at `path`, and returns the file's fingerprint. The file
/// appears complete or not at all. Its bytes depend only on its content, as long as `metadata` serializes in a fixed
/// order.
///
/// # Errors
/// When the folder cannot be written or `metadata` cannot be serialized.
pub fn write_checkpoint<M: Serialize>(
    path: &Path,
    tensors: &BTreeMap<String, Tensor>,
    metadata: &M,
) -> Result<String, Error> {
    let text = serde_json::to_string(metadata).map_err(|source| Error::Metadata { path: path.to_owned(), source })?;
    let on_host =
        |(name, tensor): (&String, &Tensor)| Ok((name.clone(), tensor.to_device(&Device::Cpu)?.contiguous()?));
    let on_host: BTreeMap<String, Tensor> = (tensors.iter().map(on_host).collect::<candle_core::Result<_>>())
        .map_err(|source| Error::Tensor { path: path.to_owned(), source })?;
    // One entry only: the safetensors crate keeps metadata in a hash map, in random order.
    let entries = HashMap::from([(METADATA_KEY.to_owned(), text)]);
    let bytes = safetensors::serialize(&on_host, Some(entries))
        .map_err(|source| Error::Format { path: path.to_owned(), source })?;

    let stamp = write_atomically::<std::io::Error>(path, |file| file.write_all(&bytes))?;
    Ok(stamp.checksum)
}

/// Reads the checkpoint at `path`, with its tensors on `device`.
///
/// # Errors
/// When the file cannot be read, is cut off, or holds no metadata of type `M`.
pub fn read_checkpoint<M: DeserializeOwned>(path: &Path, device: &Device) -> Result<Checkpoint<M>, Error> {
    regular(path)?;
    parse_checkpoint(&fs_err::read(path)?, path, device)
}

/// Parses the `bytes` of the checkpoint file at `path`.
///
/// # Errors
/// When they are cut off, or hold no metadata of type `M`.
pub fn parse_checkpoint<M: DeserializeOwned>(
    bytes: &[u8],
    path: &Path,
    device: &Device,
) -> Result<Checkpoint<M>, Error> {
    let (_, header) =
        SafeTensors::read_metadata(bytes).map_err(|source| Error::Format { path: path.to_owned(), source })?;
    let text = (header.metadata().as_ref().and_then(|entries| entries.get(METADATA_KEY)))
        .ok_or_else(|| Error::NoMetadata { path: path.to_owned() })?;
    let metadata = serde_json::from_str(text).map_err(|source| Error::Metadata { path: path.to_owned(), source })?;
    let tensors = candle_core::safetensors::load_buffer(bytes, device)
        .map_err(|source| Error::Tensor { path: path.to_owned(), source })?;
    let fingerprint = blake3::hash(bytes).to_hex().to_string();
    Ok(Checkpoint { tensors: tensors.into_iter().collect(), metadata, fingerprint })
}

/// Hash of `tensors` by name, with their types and shapes, and of `metadata`; hexadecimal. Metadata can contain the
/// hash of the rest of itself.
pub fn checksum<M: Serialize>(tensors: &BTreeMap<String, Tensor>, metadata: &M) -> serde_json::Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&serde_json::to_vec(metadata)?);
    for (name, tensor) in tensors {
        hasher.update(format!("\n{name} {:?} {:?}\n", tensor.dtype(), tensor.dims()).as_bytes());
        hasher.update(&tensor.data());
    }
    Ok(hasher.finalize().to_hex().to_string())
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Serialize, Deserialize, PartialEq)]
    struct Metadata {
        step: u64,
        scale: f64,
    }

    fn tensors() -> BTreeMap<String, Tensor> {
        let matrix = Tensor::new(&[[1f32, -2.5], [3.0, f32::MIN_POSITIVE]], &Device::Cpu).unwrap();
        let steps = Tensor::new(7i64, &Device::Cpu).unwrap();
        // A view, which is not contiguous.
        BTreeMap::from([
            ("b.weight".to_owned(), matrix.t().unwrap()),
            ("a".to_owned(), matrix),
            ("n".to_owned(), steps),
        ])
    }

    #[test]
    fn what_was_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.safetensors");
        let metadata = Metadata { step: 3, scale: 0.1 };
        let fingerprint = write_checkpoint(&path, &tensors(), &metadata).unwrap();
        let read: Checkpoint<Metadata> = read_checkpoint(&path, &Device::Cpu).unwrap();
        assert_eq!((&read.metadata, &read.fingerprint), (&metadata, &fingerprint));
        assert_eq!(read.tensors.keys().collect::<Vec<_>>(), ["a", "b.weight", "n"]);
        assert_eq!(read.tensors["b.weight"].to_vec2::<f32>().unwrap(), [[1.0, 3.0], [-2.5, f32::MIN_POSITIVE]]);
        assert_eq!(read.tensors["n"].to_scalar::<i64>().unwrap(), 7);
        // Nothing else is left in the folder.
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn bytes_depend_on_content_alone() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, scale: f64| {
            write_checkpoint(&folder.path().join(name), &tensors(), &Metadata { step: 3, scale }).unwrap()
        };
        assert_eq!(write("one", 0.1), write("two", 0.1));
        assert_ne!(write("one", 0.1), write("three", 0.2));
    }

    #[test]
    fn a_checksum_is_of_names_shapes_values_and_metadata() {
        let of = |tensors: &BTreeMap<String, Tensor>, scale| checksum(tensors, &Metadata { step: 3, scale }).unwrap();
        let (whole, mut seen) = (tensors(), std::collections::BTreeSet::new());
        assert_eq!(of(&whole, 0.1), of(&tensors(), 0.1));
        seen.extend([of(&whole, 0.1), of(&whole, 0.2)]);
        for other in [whole["a"].t().unwrap(), whole["a"].reshape((4, 1)).unwrap(), whole["a"].neg().unwrap()] {
            seen.insert(of(&BTreeMap::from([("a".to_owned(), other)]), 0.1));
        }
        seen.insert(of(&BTreeMap::from([("b".to_owned(), whole["a"].clone())]), 0.1));
        assert_eq!(seen.len(), 6);
    }

    #[test]
    fn broken_files_are_errors_that_name_the_path() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.safetensors");
        let read = || read_checkpoint::<Metadata>(&path, &Device::Cpu).unwrap_err();
        assert!(matches!(read(), Error::Io(error) if error.to_string().contains("model.safetensors")));

        write_checkpoint(&path, &tensors(), &"another kind of model").unwrap();
        assert!(matches!(read(), Error::Metadata { .. }));

        let whole = fs_err::read(&path).unwrap();
        fs_err::write(&path, &whole[..whole.len() - 1]).unwrap();
        assert!(matches!(read(), Error::Format { .. }));
        assert!(read().to_string().contains("model.safetensors"));

        fs_err::write(&path, safetensors::serialize(tensors(), None).unwrap()).unwrap();
        assert!(matches!(read(), Error::NoMetadata { .. }));
    }
}
