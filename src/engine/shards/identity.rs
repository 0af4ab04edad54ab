//! The identity that all processes that work on one plan must share.

use crate::engine::fingerprint::fingerprint_value;
use crate::engine::kind::StageKind;
use crate::engine::outdated::why;
use crate::engine::version;
use crate::engine::{ComputeChoice, Failure, Result, StageRecord};
use serde::{Deserialize, Serialize};

/// The work, the program and the kind of machine: together they determine every byte of a shard.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(in crate::engine) struct Identity {
    /// The stage with its section and inputs.
    pub(in crate::engine) stage: StageRecord,
    /// Version and revision of the program.
    pub(super) program: String,
    /// The kind of device, and the precision of matrix products.
    pub(super) compute: String,
}

impl Identity {
    /// The identity of this process for a stage with this `record`. A stage without networks runs on the processor.
    pub(super) fn own(kind: &StageKind, stage: StageRecord, compute: ComputeChoice) -> Result<Self> {
        let compute = if kind.computes { compute } else { ComputeChoice::default() };
        Ok(Self { stage, program: version()?, compute: compute.class() })
    }

    /// The plan's name: 16 hexadecimal digits.
    pub(super) fn plan_id(&self) -> Result<String> {
        let mut id = fingerprint_value(&(&self.stage.fingerprint, &self.program, &self.compute))?;
        id.truncate(16);
        Ok(id)
    }

    /// Whether the plan is for the work with this record, which may have been done elsewhere.
    pub(super) fn is_work_of(&self, record: &StageRecord) -> bool {
        self.stage.fingerprint == record.fingerprint || self.stage.is_same_work(record)
    }

    /// The difference between this process and a `plan` of another one; `None` if they fit together.
    pub(super) fn difference(&self, kind: &StageKind, plan: &Self) -> Option<String> {
        let rewritten = self.stage.rewritten_since(&plan.stage).map(why);
        let named = |what: &str, own: &str, plans: &str| {
            (own != plans).then(|| format!("{what}: the plan's is {plans}, this one is {own}"))
        };
        let differences = [
            (!self.is_work_of(&plan.stage)).then(|| self.stage.changes_since(kind, &plan.stage)).or(rewritten),
            named("program", &self.program, &plan.program),
            named("device", &self.compute, &plan.compute),
        ];
        let differences: Vec<String> = differences.into_iter().flatten().collect();
        (!differences.is_empty()).then(|| differences.join("; "))
    }

    /// The error of a process that differs from this plan in this way; it states how many shards would be lost.
    pub(super) fn refusal(
        &self,
        stage: &StageKind,
        difference: &str,
        (n_finished, n_shards): (usize, usize),
    ) -> Failure {
        Failure::input_message(format_args!(
            "this run folder holds another plan of stage {stage}: {difference}; nothing was changed"
        ))
        .with_hint(format!(
            "finish it with the same pipeline file, kind of device and program ({}), or discard it with its \
             {n_finished} finished shards of {n_shards}: plan again with --part plan --redo {stage}",
            self.program
        ))
    }
}
