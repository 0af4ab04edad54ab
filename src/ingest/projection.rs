//! Projects latitude and longitude to the plane.
//!
//! Lanelet2 projects with the universal transverse Mercator (UTM) zone of a map's origin and subtracts the origin's
//! coordinates. The series is Krüger's to the sixth order in the third flattening (Karney, "Transverse Mercator with an
//! accuracy of a few nanometers", Journal of Geodesy 85, 2011, equations 7 to 11 and 35); within a zone it is exact to
//! nanometers.

use crate::geometry::Vec2;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// WGS84 equatorial radius, meters.
const EQUATORIAL_RADIUS_M: f64 = 6_378_137.0;
/// WGS84 flattening.
const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// Scale on the central meridian of a UTM zone.
const CENTRAL_SCALE: f64 = 0.9996;
/// Easting of the central meridian of a UTM zone, meters.
const FALSE_EASTING_M: f64 = 500_000.0;

/// Maps this close to latitude and longitude zero encode meters, as INTERACTION publishes them. No road lies there, so
/// real coordinates cannot be mistaken for them.
const DISGUISE_LIMIT_DEG: f64 = 0.5;

/// The largest distance from the equator, degrees.
pub(super) const MAX_LATITUDE_DEG: f64 = 90.0;
/// The largest distance from Greenwich, degrees.
pub(super) const MAX_LONGITUDE_DEG: f64 = 180.0;

/// A point on the WGS84 ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GeoPoint {
    /// Latitude, degrees.
    #[schemars(range(min = -90.0, max = 90.0))]
    pub latitude_deg: f64,
    /// Longitude, degrees.
    #[schemars(range(min = -180.0, max = 180.0))]
    pub longitude_deg: f64,
}

impl GeoPoint {
    /// A place without roads: that of nodes whose position is unknown, and the origin of maps that encode meters.
    pub(super) const NOWHERE: Self = Self { latitude_deg: 0.0, longitude_deg: 0.0 };

    /// The southwest corner of a box around points; `None` for no points.
    pub(super) fn southwest_of(points: impl Iterator<Item = Self>) -> Option<Self> {
        points.reduce(|one, other| Self {
            latitude_deg: one.latitude_deg.min(other.latitude_deg),
            longitude_deg: one.longitude_deg.min(other.longitude_deg),
        })
    }
}

/// From latitude and longitude to meters in one UTM zone, relative to an origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LocalUtm {
    central_meridian_deg: f64,
    origin: Vec2,
}

impl LocalUtm {
    /// The zone of `origin`, in which `origin` lies at (0, 0). The exceptions of the UTM grid around Norway and
    /// Svalbard are ignored, because only distances within the map matter.
    pub(super) fn around(origin: GeoPoint) -> Self {
        let zone = ((origin.longitude_deg + 180.0) / 6.0).floor().clamp(0.0, 59.0);
        let mut projection = Self { central_meridian_deg: zone.mul_add(6.0, -177.0), origin: Vec2::ZERO };
        projection.origin = projection.project(origin);
        projection
    }

    /// The projection for a map whose lanes have their southwest corner at `corner`, and whether its origin is that
    /// corner. Maps that encode meters (all of INTERACTION) are projected around (0°, 0°), hence in zone 31.
    pub(super) fn for_map(corner: GeoPoint) -> (Self, bool) {
        let is_real =
            corner.latitude_deg.abs() >= DISGUISE_LIMIT_DEG || corner.longitude_deg.abs() >= DISGUISE_LIMIT_DEG;
        (Self::around(if is_real { corner } else { GeoPoint::NOWHERE }), is_real)
    }

    /// The direction of north at a point, radians from x: eastings run along the equator only on the central meridian.
    pub(super) fn north_rad(&self, point: GeoPoint) -> f64 {
        const BESIDE_DEG: f64 = 1e-4;
        let beside = GeoPoint { latitude_deg: point.latitude_deg - BESIDE_DEG, ..point };
        (self.project(point) - self.project(beside)).angle()
    }

    /// Meters east and north of the origin.
    pub(super) fn project(&self, point: GeoPoint) -> Vec2 {
        let northing_easting = transverse_mercator(
            point.latitude_deg.to_radians(),
            (point.longitude_deg - self.central_meridian_deg).to_radians(),
        );
        Vec2::new(northing_easting.x + FALSE_EASTING_M, northing_easting.y) - self.origin
    }
}

/// Meters east of the central meridian and north of the equator, scaled by the UTM central scale.
fn transverse_mercator(latitude_rad: f64, longitude_rad: f64) -> Vec2 {
    let n = FLATTENING / (2.0 - FLATTENING);
    let eccentricity = (FLATTENING * (2.0 - FLATTENING)).sqrt();

    // The conformal latitude as its tangent (equations 7 to 9).
    let tau = latitude_rad.tan();
    let sigma = (eccentricity * (eccentricity * tau / tau.hypot(1.0)).atanh()).sinh();
    let tau_conformal = tau.mul_add(sigma.hypot(1.0), -(sigma * tau.hypot(1.0)));

    // The transverse Mercator projection of the sphere (equation 10).
    let xi_sphere = tau_conformal.atan2(longitude_rad.cos());
    let eta_sphere = (longitude_rad.sin() / tau_conformal.hypot(longitude_rad.cos())).asinh();

    // From the sphere to the ellipsoid (equation 11).
    let (mut xi, mut eta) = (xi_sphere, eta_sphere);
    for (j, alpha) in (1..).zip(krueger_coefficients(n)) {
        let order = f64::from(2 * j);
        xi += alpha * (order * xi_sphere).sin() * (order * eta_sphere).cosh();
        eta += alpha * (order * xi_sphere).cos() * (order * eta_sphere).sinh();
    }
    let n2 = n * n;
    let rectifying_radius = EQUATORIAL_RADIUS_M / (1.0 + n) * (1.0 + n2 / 4.0 + n2 * n2 / 64.0 + n2 * n2 * n2 / 256.0);
    Vec2::new(eta, xi) * (CENTRAL_SCALE * rectifying_radius)
}

/// α₁ to α₆ (equation 35).
fn krueger_coefficients(n: f64) -> [f64; 6] {
    let polynomial = |lowest: i32, coefficients: &[f64]| {
        (lowest..).zip(coefficients).map(|(power, coefficient)| coefficient * n.powi(power)).sum::<f64>()
    };
    [
        polynomial(1, &[1.0 / 2.0, -2.0 / 3.0, 5.0 / 16.0, 41.0 / 180.0, -127.0 / 288.0, 7891.0 / 37_800.0]),
        polynomial(2, &[13.0 / 48.0, -3.0 / 5.0, 557.0 / 1440.0, 281.0 / 630.0, -1_983_433.0 / 1_935_360.0]),
        polynomial(3, &[61.0 / 240.0, -103.0 / 140.0, 15_061.0 / 26_880.0, 167_603.0 / 181_440.0]),
        polynomial(4, &[49_561.0 / 161_280.0, -179.0 / 168.0, 6_601_661.0 / 7_257_600.0]),
        polynomial(5, &[34_729.0 / 80_640.0, -3_418_889.0 / 1_995_840.0]),
        polynomial(6, &[212_378_941.0 / 319_334_400.0]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn geo(latitude_deg: f64, longitude_deg: f64) -> GeoPoint {
        GeoPoint { latitude_deg, longitude_deg }
    }

    #[test]
    fn disguised_meters_are_found_again() {
        // Reference values of UTM zone 31, given to 1e-8 m.
        let projection = LocalUtm::for_map(geo(0.009, 0.009)).0;
        let near = |lat, lon, x, y| projection.project(geo(lat, lon)).distance(Vec2::new(x, y)) < 2e-8;
        assert!(near(0.009_192_329_24, 0.008_977_405_19, 1_000.340_741_98, 1_017.423_935_80));
        assert!(near(0.008, 0.01, 1_114.285_124_67, 885.453_907_63));
        assert!(near(0.0, 0.0, 0.0, 0.0));
    }

    #[test]
    fn known_points_of_the_utm_grid() {
        // The zone's corner on the equator lies 833,978.56 m or 166,021.44 m east; the tower of Toronto is the usual
        // published example (zone 17, 630,084 m east, 4,833,439 m north).
        let equator = LocalUtm::around(geo(0.0, 3.0));
        assert!((equator.project(geo(0.0, 0.0)).x + 500_000.0 - 166_021.443_080_5).abs() < 1e-5);
        let toronto = LocalUtm::around(geo(0.0, -81.0)).project(geo(43.642_566_67, -79.387_138_89));
        assert!((toronto.x + 500_000.0 - 630_084.3).abs() < 1.0 && (toronto.y - 4_833_438.6).abs() < 1.0);
    }

    #[test]
    fn real_coordinates_are_local_to_the_corner() {
        let corner = geo(49.003_456_543_51, 8.424_275_907_07);
        let (projection, is_real) = LocalUtm::for_map(corner);
        assert!(is_real);
        assert_eq!(projection.project(corner), Vec2::ZERO);
        // One second of latitude is about 30.9 m anywhere; at this latitude one of longitude is about 20.3 m.
        let north = projection.project(geo(corner.latitude_deg + 1.0 / 3600.0, corner.longitude_deg));
        let east = projection.project(geo(corner.latitude_deg, corner.longitude_deg + 1.0 / 3600.0));
        assert!((north.norm() - 30.88).abs() < 0.05 && (east.norm() - 20.33).abs() < 0.05);
        // West of the central meridian, north is right of the grid's, by its distance times the sine of the latitude.
        let expected_deg = (corner.longitude_deg - 9.0) * corner.latitude_deg.to_radians().sin();
        assert!((projection.north_rad(corner).to_degrees() - 90.0 - expected_deg).abs() < 1e-3);
    }
}
