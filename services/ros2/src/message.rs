//! Messages of ROS 2, field by field as their `.msg` files define them.

use serde::{Deserialize, Serialize};

/// A message with the name of its type.
pub(crate) trait Named {
    /// Package and type.
    const TYPE: [&'static str; 2];
}

/// The messages, each with its package when it is used on a topic.
macro_rules! messages {
    ($($(#[$doc:meta])* $package:literal $name:ident { $($field:ident: $type:ty),* $(,)? })*) => {
        $(
            $(#[$doc])*
            #[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
            pub(crate) struct $name { $(pub(crate) $field: $type),* }

            impl Named for $name {
                const TYPE: [&'static str; 2] = [$package, stringify!($name)];
            }
        )*
    };
}

messages! {
    /// A time since an epoch that the publisher chooses.
    "builtin_interfaces" Time { sec: i32, nanosec: u32 }
    /// Stamp, and the frame of the numbers.
    "std_msgs" Header { stamp: Time, frame_id: String }
    /// Position or vector.
    "geometry_msgs" Vector3 { x: f64, y: f64, z: f64 }
    /// A rotation.
    "geometry_msgs" Quaternion { x: f64, y: f64, z: f64, w: f64 }
    /// Position and orientation.
    "geometry_msgs" Pose { position: Vector3, orientation: Quaternion }
    /// Velocities along and about the axes.
    "geometry_msgs" Twist { linear: Vector3, angular: Vector3 }
    /// The same with a stamp.
    "geometry_msgs" TwistStamped { header: Header, twist: Twist }
    /// A pose with a stamp.
    "geometry_msgs" PoseStamped { header: Header, pose: Pose }
    /// Where one frame is in another.
    "geometry_msgs" TransformStamped { header: Header, child_frame_id: String, transform: Transform }
    /// Translation and rotation.
    "geometry_msgs" Transform { translation: Vector3, rotation: Quaternion }
    /// A pose whose covariance this program does not use.
    "geometry_msgs" PoseWithCovariance { pose: Pose, covariance: [[f64; 6]; 6] }
    /// A twist whose covariance this program does not use.
    "geometry_msgs" TwistWithCovariance { twist: Twist, covariance: [[f64; 6]; 6] }
    /// Transforms.
    "tf2_msgs" TFMessage { transforms: Vec<TransformStamped> }
    /// A sweep.
    "sensor_msgs" LaserScan {
        header: Header,
        angle_min: f32,
        angle_max: f32,
        angle_increment: f32,
        time_increment: f32,
        scan_time: f32,
        range_min: f32,
        range_max: f32,
        ranges: Vec<f32>,
        intensities: Vec<f32>,
    }
    /// Pose and velocities of the base.
    "nav_msgs" Odometry {
        header: Header,
        child_frame_id: String,
        pose: PoseWithCovariance,
        twist: TwistWithCovariance,
    }
    /// Poses one after the other.
    "nav_msgs" Path { header: Header, poses: Vec<PoseStamped> }
    /// Speed and steering of a car.
    "ackermann_msgs" AckermannDrive {
        steering_angle: f32,
        steering_angle_velocity: f32,
        speed: f32,
        acceleration: f32,
        jerk: f32,
    }
    /// The same with a stamp.
    "ackermann_msgs" AckermannDriveStamped { header: Header, drive: AckermannDrive }
    /// A truth; not zero for true.
    "std_msgs" Bool { data: u8 }
    /// A gamepad or joystick.
    "sensor_msgs" Joy { header: Header, axes: Vec<f32>, buttons: Vec<i32> }
    /// What an inertial sensor measures; a negative first covariance says that there is none.
    "sensor_msgs" Imu {
        header: Header,
        orientation: Quaternion,
        orientation_covariance: [f64; 9],
        angular_velocity: Vector3,
        angular_velocity_covariance: [f64; 9],
        linear_acceleration: Vector3,
        linear_acceleration_covariance: [f64; 9],
    }
    /// A colour.
    "std_msgs" ColorRGBA { r: f32, g: f32, b: f32, a: f32 }
    /// A length of time.
    "builtin_interfaces" Duration { sec: i32, nanosec: u32 }
    /// A picture that a mesh is covered with; empty here.
    "sensor_msgs" CompressedImage { header: Header, format: String, data: Vec<u8> }
    /// A point of a picture.
    "visualization_msgs" UVCoordinate { u: f32, v: f32 }
    /// A file of a mesh; empty here.
    "visualization_msgs" MeshFile { filename: String, data: Vec<u8> }
    /// A body to be drawn.
    "visualization_msgs" Marker {
        header: Header,
        ns: String,
        id: i32,
        kind: i32,
        action: i32,
        pose: Pose,
        scale: Vector3,
        color: ColorRGBA,
        lifetime: Duration,
        frame_locked: bool,
        points: Vec<Vector3>,
        colors: Vec<ColorRGBA>,
        texture_resource: String,
        texture: CompressedImage,
        uv_coordinates: Vec<UVCoordinate>,
        text: String,
        mesh_resource: String,
        mesh_file: MeshFile,
        mesh_use_embedded_materials: bool,
    }
    /// Bodies to be drawn.
    "visualization_msgs" MarkerArray { markers: Vec<Marker> }
    /// A value with its name.
    "diagnostic_msgs" KeyValue { key: String, value: String }
    /// The state of a part.
    "diagnostic_msgs" DiagnosticStatus {
        level: u8,
        name: String,
        message: String,
        hardware_id: String,
        values: Vec<KeyValue>,
    }
    /// The states of all parts.
    "diagnostic_msgs" DiagnosticArray { header: Header, status: Vec<DiagnosticStatus> }
}

impl Time {
    /// The time in seconds.
    pub(crate) fn seconds(&self) -> f64 {
        f64::from(self.sec) + f64::from(self.nanosec) * 1e-9
    }

    /// A time of seconds; zero for one that is none.
    pub(crate) fn of_seconds(seconds: f64) -> Self {
        let seconds = if (0.0..=f64::from(i32::MAX)).contains(&seconds) { seconds } else { 0.0 };
        let nanosec = ((seconds.fract() * 1e9) as u32).min(999_999_999);
        Self { sec: seconds as i32, nanosec }
    }
}

impl Quaternion {
    /// A turn about the vertical axis [rad].
    pub(crate) fn of_yaw(yaw_rad: f64) -> Self {
        let (z, w) = (yaw_rad / 2.0).sin_cos();
        Self { x: 0.0, y: 0.0, z, w }
    }

    /// The yaw of the rotated forward axis [rad].
    pub(crate) fn yaw_rad(&self) -> f64 {
        let Self { x, y, z, w } = *self;
        (2.0 * (w * z + x * y)).atan2(w * w + x * x - y * y - z * z)
    }

    /// The rotation of a vector.
    pub(crate) fn rotate(&self, of: &Vector3) -> Vector3 {
        let Self { x, y, z, w } = *self;
        let norm = (x * x + y * y + z * z + w * w).max(f64::MIN_POSITIVE);
        let s = 2.0 / norm;
        Vector3 {
            x: (1.0 - s * (y * y + z * z)) * of.x + s * (x * y - w * z) * of.y + s * (x * z + w * y) * of.z,
            y: s * (x * y + w * z) * of.x + (1.0 - s * (x * x + z * z)) * of.y + s * (y * z - w * x) * of.z,
            z: s * (x * z - w * y) * of.x + s * (y * z + w * x) * of.y + (1.0 - s * (x * x + y * y)) * of.z,
        }
    }

    /// First `other`, then this rotation.
    pub(crate) fn after(&self, other: &Self) -> Self {
        let (a, b) = (self, other);
        Self {
            x: a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            y: a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
            z: a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
            w: a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;

    #[test]
    fn a_stamp_comes_back_from_its_seconds() {
        let time = Time { sec: 1_764_000_000, nanosec: 250_000_000 };
        assert_eq!(Time::of_seconds(time.seconds()), time);
        assert_eq!(
            [f64::NAN, -1.0, 1e12].map(Time::of_seconds),
            [Time::default(), Time::default(), Time::default()]
        );
    }

    #[test]
    fn a_turn_to_the_left_turns_ahead_to_the_left() {
        let left = Quaternion::of_yaw(FRAC_PI_2);
        let turned = left.rotate(&Vector3 { x: 2.0, y: 0.0, z: 1.0 });
        assert!(turned.x.abs() < 1e-12 && (turned.y - 2.0).abs() < 1e-12 && turned.z == 1.0);
        assert!((left.yaw_rad() - FRAC_PI_2).abs() < 1e-12);
        assert!((left.after(&left).yaw_rad().abs() - PI).abs() < 1e-12);
        // Upside down about the forward axis: left becomes right, ahead stays.
        let over = Quaternion { x: 1.0, ..Quaternion::default() };
        assert!((over.rotate(&Vector3 { y: 1.0, ..Vector3::default() }).y + 1.0).abs() < 1e-12);
        assert!(over.yaw_rad().abs() < 1e-12);
    }
}
