//! The constants of the diffusion as checkpoints name them: with σ_data, so that other programs need not know it.

use crate::diffusion::{Edm, SIGMA_DATA};
use crate::tensor::Normalizer;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

const _: () = assert!(Normalizer::SIGMA_DATA == SIGMA_DATA, "data is scaled to what the diffusion expects");

#[derive(Serialize, Deserialize)]
struct Named {
    sigma_data: f64,
    #[serde(flatten)]
    edm: Edm,
}

pub(super) fn serialize<S: Serializer>(edm: &Edm, to: S) -> Result<S::Ok, S::Error> {
    Named { sigma_data: SIGMA_DATA, edm: *edm }.serialize(to)
}

pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Edm, D::Error> {
    let Named { sigma_data, edm } = Named::deserialize(from)?;
    if sigma_data != SIGMA_DATA {
        return Err(de::Error::custom(format!("edm.sigma_data is {sigma_data}, expected {SIGMA_DATA}")));
    }
    Ok(edm)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize, Deserialize)]
    struct Checkpoint {
        #[serde(with = "super")]
        edm: Edm,
    }

    #[test]
    fn checkpoints_name_sigma_data_which_has_one_value() {
        let text = r#"{"edm":{"sigma_data":0.5,"sigma_min":0.002,"sigma_max":40.0,"rho":7.0}}"#;
        let read: Checkpoint = serde_json::from_str(text).unwrap();
        assert_eq!(read.edm, Edm { sigma_max: 40.0, ..Edm::default() });
        assert_eq!(serde_json::to_string(&read).unwrap(), text);
        let error = serde_json::from_str::<Checkpoint>(&text.replace("0.5", "0.7")).err().unwrap().to_string();
        assert!(error.contains("edm.sigma_data is 0.7, expected 0.5"), "{error}");
        assert!(serde_json::from_str::<Checkpoint>(r#"{"edm":{"sigma_max":40.0}}"#).is_err());
    }
}
