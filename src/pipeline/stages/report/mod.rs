//! The page that people read, from the outputs of the stages.

mod drawings;
mod gather;

use crate::engine::{Failure, Result, Stage, StageContext, StageInput, StageKind, Whole, Work};
use crate::pipeline::StageId;
use crate::pipeline::layout::{FIGURES, Layout, REPORT};
use crate::report::{ReportConfig, figures, render};
use crate::store::write_atomically;
use serde::Serialize;
use serde_json::{Value, json};
use std::io::Write;

/// The stage.
pub struct Report<'a> {
    /// Its section.
    pub config: &'a ReportConfig,
    /// The stages to report on.
    pub parts: Vec<StageId>,
    /// Name and seed of the pipeline, and its configuration as TOML.
    pub about: About,
    /// Where the outputs of the other stages are.
    pub layout: &'a Layout,
}

/// The report's facts about the pipeline as a whole.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct About {
    /// Name of the pipeline.
    pub pipeline: String,
    /// Seed of the run.
    pub seed: u64,
    /// The device that networks computed on.
    pub device: String,
    /// The resolved configuration, as TOML.
    #[serde(skip)]
    pub config: String,
    /// The portable configuration without paths: a report is not made anew because paths have changed.
    #[serde(rename = "config")]
    pub settings: String,
}

impl Stage for Report<'_> {
    fn kind(&self) -> &'static StageKind {
        StageId::Report.kind()
    }

    fn version(&self) -> u32 {
        9
    }

    fn check(&self) -> Result<()> {
        if self.parts.is_empty() {
            let folder = self.layout.scenes.parent().unwrap_or(&self.layout.scenes).display();
            let message = format_args!("{folder} has no results of a run to report on");
            return Err(Failure::input_message(message)
                .with_hint("name the folder of a run, such as output/quickstart/main; `djinn run` prints it"));
        }
        Ok(())
    }

    fn config(&self) -> anyhow::Result<Value> {
        let mut config = serde_json::to_value(self.config)?;
        config["about"] = serde_json::to_value(&self.about)?;
        Ok(config)
    }

    fn inputs(&self) -> Vec<StageInput> {
        let input =
            |stage: &StageId| stage.output(self.layout).map(|(name, path)| StageInput::made_by(*stage, name, path));
        self.parts.iter().filter_map(input).collect()
    }

    fn work(&self) -> Work<'_> {
        Work::Whole(self)
    }
}

impl Whole for Report<'_> {
    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        context.progress.start("report", 0, "parts");
        let model = gather::model(self)?;
        let page = render(&model);
        write_atomically::<std::io::Error>(&context.root.join(REPORT), |file| file.write_all(page.as_bytes()))?;
        let folder = context.root.join(FIGURES);
        fs_err::create_dir_all(&folder)?;
        let figures = figures(&model);
        for figure in &figures {
            write_atomically::<std::io::Error>(&folder.join(&figure.name), |file| {
                file.write_all(figure.svg.as_bytes())
            })?;
        }
        context.progress.finish();
        Ok(json!({
            "n_bytes": page.len(),
            "n_drawn": model.scenes.len(),
            "n_figures": figures.len(),
            "n_warnings": model.warnings.len(),
        }))
    }
}

impl Report<'_> {
    /// Whether the report covers this stage.
    fn has(&self, stage: StageId) -> bool {
        self.parts.contains(&stage)
    }
}
