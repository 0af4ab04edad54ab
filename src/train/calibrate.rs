//! Takes a trained denoiser to other recordings without training it.

use super::training_data::{SceneConstants, TrainingData};
use super::{Error, MODEL_FILE, TrainJob};
use crate::model::DenoiserSpec;
use crate::nn::{Checkpoint, write_checkpoint};

/// Writes a checkpoint of the same weights to `model.safetensors` in the job's folder, whose scales of motion are those
/// of these scenes ([`Normalizer::for_motion_of`](crate::tensor::Normalizer::for_motion_of)). Returns its fingerprint.
///
/// What is diffused is then white for them, as it was for the scenes that the denoiser was trained on: it samples the
/// patterns of motion that it knows, with the spread and the texture of these recordings.
///
/// # Errors
/// When there is no scene, scenes are not of the denoiser's shape, or too few of their tracks are complete.
pub fn calibrate_denoiser(
    checkpoint: &Checkpoint<DenoiserSpec>,
    data: &TrainingData<'_>,
    job: TrainJob<'_>,
) -> Result<String, Error> {
    let mut spec = checkpoint.metadata.clone();
    data.check_shape(&spec, "calibrate")?;
    let derives_headings = spec.network.geometry.is_some();
    let found = SceneConstants::gather(data, spec.normalizer.parametrization, derives_headings, job)?;
    if spec.normalizer.motion_covariance.is_none() || found.normalizer.motion_covariance.is_none() {
        let why = "calibrate needs a denoiser that diffuses motion, and scenes with tracks that are complete";
        return Err(Error::Config(why.to_owned()));
    }
    data.warn_if_few("calibrated", job.progress);
    spec.normalizer = spec.normalizer.for_motion_of(&found.normalizer);
    Ok(write_checkpoint(&job.dir.join(MODEL_FILE), &checkpoint.tensors, &spec)?)
}
