//! The columns of the scenario table for its assessment: validity, criticality, novelty.

use super::columns::{
    Columns, entries, lists, numbers, optional_flags, optional_numbers, optional_texts, small, structs, texts,
};
use crate::behavior::{Cause, Explanation};
use crate::metrics::{CarefulJudgment, Check, Ending, PairCriticality, SceneCriticality, Violation};
use crate::rates::{BucketRate, RateSource};
use crate::scenario::Assessment;
use crate::scene::TrackId;
use crate::statistics::Interval;
use crate::store::Result;
use crate::store::schema::{ColumnExt, column, list_of, list_of_structs};
use arrow::array::ArrayRef;
use arrow::datatypes::{DataType, Field, Float64Type, UInt32Type};

/// The columns, in order. All are missing, or empty lists, if a scenario was not judged.
pub(crate) fn fields() -> Vec<Field> {
    let number =
        |name: &str, unit: &str, description: &str| column(name, DataType::Float64, description).unit(unit).optional();
    let flag = |name: &str, description: &str| column(name, DataType::Boolean, description).optional();
    vec![
        flag("accepted", "Whether it is verified, valid, with a cause if it needs one, and no near-duplicate."),
        flag("valid", "Whether it passes every validity check."),
        column("violations", list_of(DataType::Utf8), "The validity checks that it fails, such as collision or jerk.")
            .optional(),
        details_field(),
        number(
            "plausibility",
            "1",
            "Share of its motion, quantity by quantity, within the range that holds all recorded motion but a \
             thousandth at either end.",
        ),
        number(
            "recorded_likeness",
            "1",
            "Probability that its tracks were recorded, from the mean of their log odds for a classifier that has not \
             seen its scene; missing if the sweep has too few tracks to learn from.",
        ),
        number(
            "pair_min_ttc_s",
            "s",
            "Least time to collision of the requested agents, in the future; missing if they would not collide within \
             10 s.",
        ),
        number("pair_tet_s", "s", "Time during which their time to collision is below 1.5 s."),
        number("pair_tit_s2", "s^2", "That time, weighted by how far it is below."),
        number(
            "pair_max_drac_mps2",
            "m/s^2",
            "Largest deceleration rate to avoid a crash of the requested agents, at most 20; 0 if none is needed.",
        ),
        number(
            "pair_min_headway_s",
            "s",
            "Least time headway of either of the requested agents behind the other; missing if neither follows.",
        ),
        number(
            "pair_pet_s",
            "s",
            "Post-encroachment time of the requested agents; missing if their paths do not cross.",
        ),
        number(
            "pair_min_distance_m",
            "m",
            "Smallest distance between the boxes of the requested agents; 0 if they overlap.",
        ),
        number("scene_min_ttc_s", "s", "Least time to collision of any two agents."),
        number("scene_max_drac_mps2", "m/s^2", "Largest deceleration rate to avoid a crash of any two agents."),
        number(
            "scene_min_distance_m",
            "m",
            "Smallest distance between the boxes of any two agents of which one moves.",
        ),
        flag(
            "preventable",
            "Whether the careful driver of UN Regulation No. 157, in place of the subject, avoids any contact but at \
             its rear if all others move as they do; missing if the event is its own or comes from behind.",
        ),
        number(
            "careful_braking_from_s",
            "s",
            "When that driver begins to brake hard, since the present; missing if it does not.",
        ),
        number(
            "careful_margin_s",
            "s",
            "By how much later that driver could react and still avoid any contact, at most 2; negative if it would \
             have to react sooner, and -0.75 if that is not enough either.",
        ),
        number(
            "intrusion_ttc_s",
            "s",
            "For a cut-in: time to collision when the other is 0.3 m beyond the lane marking; missing if the gap does \
             not close then.",
        ),
        flag(
            "avoidance_required",
            "Whether that time exceeds v_rel / (2 · 6 m/s²) + 0.35 s, and the other has moved across for 0.72 s, so \
             that the regulation requires that a collision be avoided; missing where that time is.",
        ),
        flag(
            "subject_reacts",
            "Whether the subject slows down by at least 1 m/s² over half a second, at some time since the event began.",
        ),
        number(
            "end_contact_s",
            "s",
            "When the subject touches somebody ahead of it if all keep the velocities of its last state, since then; \
             missing if it does not within a second.",
        ),
        number(
            "end_required_deceleration_mps2",
            "m/s^2",
            "The least steady deceleration from its last state on with which the subject does not, at most 20; 0 if \
             none is needed.",
        ),
        number(
            "end_remaining_mps",
            "m/s",
            "The relative speed with which they touch although the careful driver takes over at the last state, and \
             brakes 0.75 s later, or at once if the subject brakes already; missing if they do not.",
        ),
        column(
            "cause",
            DataType::Utf8,
            "What explains a hard brake (comes_in, crosses, vulnerable, stands_ahead, brakes_ahead, slower_ahead, \
             stop_line) or a near miss (looked_too_late, gap_misjudged); missing if nothing does, and for other \
             events.",
        )
        .optional(),
        number(
            "mistake_s",
            "s",
            "How much too late one looked, or by how much the gap was too small; missing without a mistake.",
        ),
        number(
            "nearest_recorded_event",
            "1",
            "Distance of its event from the nearest recorded one of the behavior: root mean square over parameters, \
             each in its typical spread.",
        ),
        number(
            "nearest_scenario_m",
            "m",
            "Mean distance between the paths of the requested agents and those of the nearest earlier accepted \
             scenario, in the frame of the first of the agents.",
        ),
        column("near_duplicate_of", DataType::Utf8, "That scenario, if the two are near-duplicates.").optional(),
        number(
            "rate_per_1000_km",
            "1/(1000 km)",
            "How often events of its bucket (without a request, of its behavior) happen in 1,000 km of motorized road \
             users at its place; missing where rate_source is none.",
        ),
        number("rate_per_hour", "1/h", "The same an hour."),
        number("rate_low", "1/(1000 km)", "Lower end of the 95 % interval of rate_per_1000_km."),
        number("rate_high", "1/(1000 km)", "Upper end of it; also where none was recorded."),
        column(
            "rate_source",
            DataType::Utf8,
            "What the rate is from: recorded events, extrapolated from less severe ones, modeled by closed loops of \
             the unguided model that agree with recordings, or none. Generated scenarios never count. Missing without \
             a verified event, or if nothing was counted.",
        )
        .optional(),
    ]
}

fn details_field() -> Field {
    let members = vec![
        column("check", DataType::Utf8, "The check."),
        column("track_id", DataType::Utf8, "The track at the worst place; for a collision, the first of the two."),
        column("timestep", DataType::UInt32, "The timestep there.").unit("1"),
        column("value", DataType::Float64, "The value there, in the unit of the check."),
        column("limit", DataType::Float64, "The limit, in the unit of the check."),
    ];
    column(
        "violation_details",
        list_of_structs(members),
        "The worst place of each check that it fails, in the order of violations.",
    )
    .optional()
}

pub(crate) fn columns_of(assessment: &Assessment) -> Result<Vec<(Field, ArrayRef)>> {
    Ok(fields().into_iter().zip(encode(&[("assessment", Some(assessment))])?).collect())
}

/// The arrays of these assessments, in the order of [`fields`]; the ids of scenarios are for messages.
pub(crate) fn encode(rows: &[(&str, Option<&Assessment>)]) -> Result<Vec<ArrayRef>> {
    let judged = || rows.iter().map(|(_, assessment)| *assessment);
    let violations = |assessment: Option<&Assessment>| assessment.map_or(0, |a| a.violations.len());
    let all = || judged().flatten().flat_map(|assessment| &assessment.violations);
    let timesteps: Result<Vec<u32>> = rows
        .iter()
        .flat_map(|(id, assessment)| assessment.iter().flat_map(|a| &a.violations).map(move |v| (id, v)))
        .map(|(id, violation)| small(id, "timestep", violation.timestep))
        .collect();
    let details = vec![
        texts(all().map(|violation| violation.check.name())),
        texts(all().map(|violation| violation.track.0.as_str())),
        numbers::<UInt32Type>(timesteps?),
        numbers::<Float64Type>(all().map(|violation| violation.value)),
        numbers::<Float64Type>(all().map(|violation| violation.limit)),
    ];
    let number = |of: &dyn Fn(&Assessment) -> Option<f64>| optional_numbers::<Float64Type>(judged().map(|a| of(a?)));
    let flag = |of: &dyn Fn(&Assessment) -> Option<bool>| optional_flags(judged().map(|a| of(a?)));
    let pair = |of: fn(&PairCriticality) -> Option<f64>| number(&|a| of(a.pair.as_ref()?));
    let scene = |of: fn(&SceneCriticality) -> Option<f64>| number(&|a| of(a.scene.as_ref()?));
    Ok(vec![
        flag(&|a| Some(a.accepted)),
        flag(&|a| Some(a.is_valid())),
        lists(judged().map(violations), texts(all().map(|violation| violation.check.name()))),
        lists(judged().map(violations), structs("scenario", details_field().data_type(), details)?),
        number(&|a| a.plausibility),
        number(&|a| a.recorded_likeness),
        pair(|p| p.min_ttc_s),
        pair(|p| Some(p.tet_s)),
        pair(|p| Some(p.tit_s2)),
        pair(|p| Some(p.max_drac_mps2)),
        pair(|p| p.min_headway_s),
        pair(|p| p.pet_s),
        pair(|p| Some(p.min_distance_m)),
        scene(|s| s.min_ttc_s),
        scene(|s| Some(s.max_drac_mps2)),
        scene(|s| Some(s.min_distance_m)),
        flag(&|a| Some(a.careful?.preventable)),
        number(&|a| a.careful?.braking_from_s),
        number(&|a| a.careful?.margin_s),
        number(&|a| a.careful?.intrusion_ttc_s),
        flag(&|a| a.careful?.avoidance_required),
        flag(&|a| Some(a.ending?.subject_reacts)),
        number(&|a| a.ending?.contact_s),
        number(&|a| Some(a.ending?.required_deceleration_mps2)),
        number(&|a| a.ending?.remaining_mps),
        optional_texts(judged().map(|a| Some(a?.explanation?.cause.name()))),
        number(&|a| a.explanation?.mistake_s),
        number(&|a| a.nearest_recorded_event),
        number(&|a| a.nearest_scenario_m),
        optional_texts(judged().map(|a| a?.near_duplicate_of.as_deref())),
        number(&|a| a.rate?.per_1000_km),
        number(&|a| a.rate?.per_hour),
        number(&|a| Some(a.rate?.interval?.low)),
        number(&|a| Some(a.rate?.interval?.high)),
        optional_texts(judged().map(|a| Some(a?.rate?.source.name()))),
    ])
}

/// The assessment in a row; `None` if the scenario was not judged.
pub(crate) fn decode(columns: &Columns<'_>, row: usize) -> Result<Option<Assessment>> {
    let number = |name: &str| columns.optional_number::<Float64Type>(name, row);
    let Some(accepted) = columns.optional_flag("accepted", row)? else { return Ok(None) };
    let (list, details) = columns.of_list("violation_details")?;
    let violation = |i: usize| {
        Ok(Violation {
            check: details.named("check", i, Check::from_name)?,
            track: TrackId::from(details.text("track_id", i)?),
            timestep: details.number::<UInt32Type>("timestep", i)? as usize,
            value: details.number::<Float64Type>("value", i)?,
            limit: details.number::<Float64Type>("limit", i)?,
        })
    };
    let pair = match (number("pair_min_distance_m")?, number("pair_max_drac_mps2")?) {
        (Some(min_distance_m), Some(max_drac_mps2)) => Some(PairCriticality {
            min_ttc_s: number("pair_min_ttc_s")?,
            tet_s: number("pair_tet_s")?.unwrap_or_default(),
            tit_s2: number("pair_tit_s2")?.unwrap_or_default(),
            max_drac_mps2,
            min_headway_s: number("pair_min_headway_s")?,
            pet_s: number("pair_pet_s")?,
            min_distance_m,
        }),
        _ => None,
    };
    let scene = match (number("scene_min_distance_m")?, number("scene_max_drac_mps2")?) {
        (Some(min_distance_m), Some(max_drac_mps2)) => {
            Some(SceneCriticality { min_ttc_s: number("scene_min_ttc_s")?, max_drac_mps2, min_distance_m })
        }
        _ => None,
    };
    let careful = match columns.optional_flag("preventable", row)? {
        Some(preventable) => Some(CarefulJudgment {
            preventable,
            braking_from_s: number("careful_braking_from_s")?,
            margin_s: number("careful_margin_s")?,
            intrusion_ttc_s: number("intrusion_ttc_s")?,
            avoidance_required: columns.optional_flag("avoidance_required", row)?,
        }),
        None => None,
    };
    let ending = match (columns.optional_flag("subject_reacts", row)?, number("end_required_deceleration_mps2")?) {
        (Some(subject_reacts), Some(required_deceleration_mps2)) => Some(Ending {
            contact_s: number("end_contact_s")?,
            required_deceleration_mps2,
            remaining_mps: number("end_remaining_mps")?,
            subject_reacts,
        }),
        _ => None,
    };
    Ok(Some(Assessment {
        accepted,
        violations: entries(list, row).map(violation).collect::<Result<_>>()?,
        plausibility: number("plausibility")?,
        recorded_likeness: number("recorded_likeness")?,
        pair,
        scene,
        careful,
        ending,
        explanation: match columns.optional_text("cause", row)? {
            Some(_) => Some(Explanation {
                cause: columns.named("cause", row, Cause::from_name)?,
                mistake_s: number("mistake_s")?,
            }),
            None => None,
        },
        nearest_recorded_event: number("nearest_recorded_event")?,
        nearest_scenario_m: number("nearest_scenario_m")?,
        near_duplicate_of: columns.optional_text("near_duplicate_of", row)?.map(str::to_owned),
        rate: match columns.optional_text("rate_source", row)? {
            Some(_) => Some(BucketRate {
                per_1000_km: number("rate_per_1000_km")?,
                per_hour: number("rate_per_hour")?,
                interval: number("rate_low")?.zip(number("rate_high")?).map(|(low, high)| Interval { low, high }),
                source: columns.named("rate_source", row, RateSource::from_name)?,
            }),
            None => None,
        },
    }))
}
