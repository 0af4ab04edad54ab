//! Angles: wrapping, differences, and unwrapping along time.

use std::f64::consts::{PI, TAU};

/// The direction `angle_rad` in (-π, π].
pub fn wrap_angle(angle_rad: f64) -> f64 {
    if angle_rad > -PI && angle_rad <= PI {
        return angle_rad;
    }
    let wrapped = angle_rad.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

/// The signed turn from `from_rad` to `to_rad`, in (-π, π].
pub fn angle_difference(to_rad: f64, from_rad: f64) -> f64 {
    wrap_angle(to_rad - from_rad)
}

/// Adds multiples of 2π so that neighboring entries differ by at most π; the first entry is kept.
pub fn unwrap_angles(angles_rad: &mut [f64]) {
    for i in 1..angles_rad.len() {
        angles_rad[i] = angles_rad[i - 1] + angle_difference(angles_rad[i], angles_rad[i - 1]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn wrapping_keeps_the_direction(angle in -50.0..50.0f64) {
            let wrapped = wrap_angle(angle);
            prop_assert!(wrapped > -PI - 1e-12 && wrapped <= PI + 1e-12);
            prop_assert!((wrapped.sin() - angle.sin()).abs() < 1e-9 && (wrapped.cos() - angle.cos()).abs() < 1e-9);
        }

        #[test]
        fn unwrapping_undoes_wrapping(steps in prop::collection::vec(-3.0..3.0f64, 1..40)) {
            let mut angle = 0.0;
            let path: Vec<f64> = steps.iter().map(|step| { angle += step; angle }).collect();
            let mut unwrapped: Vec<f64> = path.iter().map(|a| wrap_angle(*a)).collect();
            let offset = unwrapped[0] - path[0];
            unwrap_angles(&mut unwrapped);
            for (u, p) in unwrapped.iter().zip(&path) {
                prop_assert!((u - p - offset).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn pi_is_its_own_representative() {
        assert!((wrap_angle(PI) - PI).abs() < 1e-15);
        assert!((wrap_angle(-PI) - PI).abs() < 1e-15);
    }
}
