//! Self-describing checkpoint files: how are tensors and what they mean kept together, whole or not at all?

use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::Path;

use candle_core::{Device, Tensor};
use safetensors::SafeTensors;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::error::Error;

/// The entry of the safetensors metadata that holds ours, as JSON.
const METADATA_KEY: &str = "djinn";

/// What a checkpoint file holds.
#[derive(Debug, Clone)]
pub struct Checkpoint<M> {
    /// Tensors by name.
    pub tensors: BTreeMap<String, Tensor>,
    /// What the tensors are: the configuration, the normalization, the position in training.
    pub metadata: M,
    /// BLAKE3 hash of the file in hexadecimal digits.
    pub fingerprint: String,
}

/// Writes `tensors` and `metadata` to a safetensors file at `path`, and returns the file's fingerprint. The file appears
/// whole or not at all, and its bytes depend on its content alone as long as `metadata` serializes in a fixed order.
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

    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let mut file = fs_err::File::create(Path::new(&partial))?;
    file.write_all(&bytes)?;
    file.sync_all()?;
    fs_err::rename(Path::new(&partial), path)?;
    Ok(blake3::hash(&bytes).to_hex().to_string())
}

/// Reads the checkpoint at `path`, with its tensors on `device`.
///
/// # Errors
/// When the file cannot be read, is cut off, or holds no metadata of type `M`.
pub fn read_checkpoint<M: DeserializeOwned>(path: &Path, device: &Device) -> Result<Checkpoint<M>, Error> {
    let bytes = fs_err::read(path)?;
    let (_, header) =
        SafeTensors::read_metadata(&bytes).map_err(|source| Error::Format { path: path.to_owned(), source })?;
    let text = (header.metadata().as_ref().and_then(|entries| entries.get(METADATA_KEY)))
        .ok_or_else(|| Error::NoMetadata { path: path.to_owned() })?;
    let metadata = serde_json::from_str(text).map_err(|source| Error::Metadata { path: path.to_owned(), source })?;
    let tensors = candle_core::safetensors::load_buffer(&bytes, device)
        .map_err(|source| Error::Tensor { path: path.to_owned(), source })?;
    let fingerprint = blake3::hash(&bytes).to_hex().to_string();
    Ok(Checkpoint { tensors: tensors.into_iter().collect(), metadata, fingerprint })
}
