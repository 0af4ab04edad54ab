//! The columns on the identity, the origin and the findings of a scenario; sample shards and scenario tables share
//! them.

use super::columns::{Columns, flags, numbers, optional_numbers, optional_texts, small, texts};
use super::{event_list, request, roles};
use crate::scenario::ScenarioRecord;
use crate::scene::{GuidanceLevel, GuidanceTag, ObservationMask, Provenance, Scenario, Scene};
use crate::store::Result;
use crate::store::schema::{ColumnExt, column};
use arrow::array::ArrayRef;
use arrow::datatypes::{DataType, Field, Float64Type, UInt32Type, UInt64Type};

/// The columns, in order.
pub(crate) fn fields() -> Vec<Field> {
    let mut fields = vec![
        column("scenario_id", DataType::Utf8, "The scenario; unique within a corpus."),
        column("sweep", DataType::Utf8, "The sweep of the configuration that asked for it."),
        column(
            "requested_behavior",
            DataType::Utf8,
            "The behavior that was asked for; missing for unconditional sampling.",
        )
        .optional(),
        column("verified", DataType::Boolean, "Whether the miner found the requested behavior in it."),
        column(
            "recorded_event",
            DataType::Boolean,
            "Whether the recording held the requested behavior for these roles already.",
        ),
        column(
            "observation",
            DataType::Utf8,
            "Which states were observed: the name of a training task, such as predictive, or mask.",
        ),
        column(
            "edit_tau",
            DataType::Float64,
            "Noise level from which an edited recording was denoised again; missing if nothing was edited.",
        )
        .unit("1")
        .optional(),
        column(
            "guidance_kind",
            DataType::Utf8,
            "The guidance it was sampled with, such as none, classifier:cut_in or classifier_free; scene_transformer \
             for the baseline.",
        ),
        column(
            "guidance_strength",
            DataType::Float64,
            "Strength α of the guidance by classifier and objectives; 0 without.",
        )
        .unit("1"),
        column("guidance_weight", DataType::Float64, "Weight λ of classifier-free guidance; 0 without.").unit("1"),
        roles::field("guidance_roles", "The tracks that the guidance acted on; empty without guidance."),
        column("seed", DataType::UInt64, "Seed of the run."),
        column("sample_idx", DataType::UInt32, "Which sample of its scene and guidance it is."),
        column(
            "probability",
            DataType::Float64,
            "How likely the model holds it to be among the futures of its scene; missing if samples are equally \
             likely.",
        )
        .unit("1")
        .optional(),
        column("sampler", DataType::Utf8, "Sampler and number of steps, such as heun-50; forward-1 for the baseline."),
        column("checkpoint", DataType::Utf8, "Fingerprint of the checkpoint of the denoiser or baseline."),
        column("classifier", DataType::Utf8, "Fingerprint of the classifier checkpoint; missing if none was used.")
            .optional(),
        column(
            "settings",
            DataType::Utf8,
            "Every setting it was sampled with, as JSON: sampler, observed states, edits, guidance, objectives with \
             their options.",
        )
        .optional(),
        column(
            "ego_driver",
            DataType::Utf8,
            "Who drove the ego in the closed loop in which the scenario goes on: model, log, constant_velocity, idm or \
             careful; missing if it ends with its sample.",
        )
        .optional(),
    ];
    fields.extend(request::fields());
    fields.push(event_list::field());
    fields
}

/// The arrays of these records, in the order of [`fields`].
pub(crate) fn encode(records: &[&ScenarioRecord]) -> Result<Vec<ArrayRef>> {
    let provenance = || records.iter().map(|record| &record.scenario.provenance);
    let sample_idx: Result<Vec<u32>> = records
        .iter()
        .map(|record| small(&record.scenario.id, "sample index", record.scenario.provenance.sample_idx))
        .collect();
    let events: Vec<_> = records.iter().map(|record| record.events.as_slice()).collect();
    let mut arrays = vec![
        texts(records.iter().map(|record| record.scenario.id.as_str())),
        texts(records.iter().map(|record| record.sweep.as_str())),
        optional_texts(records.iter().map(|record| record.requested_behavior.as_deref())),
        flags(records.iter().map(|record| record.verified)),
        flags(records.iter().map(|record| record.recorded_event)),
        texts(provenance().map(|p| p.observation.as_str())),
        optional_numbers::<Float64Type>(provenance().map(|p| p.edit_tau)),
        texts(provenance().map(|p| p.guidance.kind.as_str())),
        numbers::<Float64Type>(provenance().map(|p| p.guidance.level.strength)),
        numbers::<Float64Type>(provenance().map(|p| p.guidance.level.weight)),
        roles::encode(&provenance().map(|p| &p.guidance.roles).collect::<Vec<_>>())?,
        numbers::<UInt64Type>(provenance().map(|p| p.seed)),
        numbers::<UInt32Type>(sample_idx?),
        optional_numbers::<Float64Type>(provenance().map(|p| p.probability)),
        texts(provenance().map(|p| p.sampler.as_str())),
        texts(provenance().map(|p| p.checkpoint.as_str())),
        optional_texts(provenance().map(|p| p.classifier.as_deref())),
        texts(provenance().map(|p| p.settings.as_str())),
        optional_texts(provenance().map(|p| p.ego_driver.as_deref())),
    ];
    arrays.extend(request::encode(records)?);
    arrays.push(event_list::encode(&events)?);
    Ok(arrays)
}

/// The record in a row, with its scene, which bears the name of the recording, and the mask of its observed states.
pub(crate) fn decode(
    columns: &Columns<'_>,
    row: usize,
    scene: Scene,
    observed: ObservationMask,
) -> Result<ScenarioRecord> {
    let text = |name: &str| columns.text(name, row).map(str::to_owned);
    let optional_text = |name: &str| columns.optional_text(name, row).map(|text| text.map(str::to_owned));
    let kind = text("guidance_kind")?;
    let strength = columns.number::<Float64Type>("guidance_strength", row)?;
    let level = GuidanceLevel { strength, weight: columns.number::<Float64Type>("guidance_weight", row)? };
    let provenance = Provenance {
        scene_id: scene.id.clone(),
        observation: text("observation")?,
        edit_tau: columns.optional_number::<Float64Type>("edit_tau", row)?,
        checkpoint: text("checkpoint")?,
        classifier: optional_text("classifier")?,
        seed: columns.number::<UInt64Type>("seed", row)?,
        sample_idx: columns.number::<UInt32Type>("sample_idx", row)? as usize,
        probability: columns.optional_number::<Float64Type>("probability", row)?,
        guidance: GuidanceTag { kind, level, roles: roles::decode(columns, "guidance_roles", row)? },
        sampler: text("sampler")?,
        ego_driver: optional_text("ego_driver")?,
        settings: optional_text("settings")?.unwrap_or_default(),
    };
    let (shard, request) = request::decode(columns, row)?;
    Ok(ScenarioRecord {
        sweep: text("sweep")?,
        requested_behavior: optional_text("requested_behavior")?,
        verified: columns.flag("verified", row)?,
        recorded_event: columns.flag("recorded_event", row)?,
        assessment: None,
        events: event_list::decode(columns, row, &scene.id)?,
        shard,
        request,
        scenario: Scenario { id: text("scenario_id")?, scene, observed, provenance },
    })
}
