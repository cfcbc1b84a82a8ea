//! Optics of a 40x/0.8 W objective at 0.32 µm/px, from a real focal stack (`docs/tips.md`); lengths in px, heights as the blur radius
//! that they make. Another pixel size multiplies all of them.

/// Blur radius of glass in focus, and of bent light.
pub const BODY: f64 = 2.16;
pub const EDGE: f64 = 3.55;
/// Blur radius of glass that a unit of height adds: the tangent of the objective's half angle.
pub const BODY_SLOPE: f64 = 0.753;
/// Blur of bent light over that of glass, far from focus.
pub const EDGE_SLOPE: f32 = 0.133;
/// Height at which walls bend no light, and from there to where they bend most.
pub const NULL: f32 = 3.44;
pub const DEPTH: f32 = 5.64;
/// Width of the seam over the blur of its edge.
pub const SPREAD: f32 = 1.327;
/// Radius of the lumen over that of the glass, and how much of the glass's darkness it lacks.
pub const LUMEN: f32 = 0.508;
pub const BRIGHTNESS: f32 = 0.524;
