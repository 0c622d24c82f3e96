"""Topics of ours, and the types of ROS that hold a sensor's readings and the channels."""

from tam_calibration.messages.point_cloud import is_channel
from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.further_channels import topic_of

MAGNETIC_FIELD, FLOAT64 = "sensor_msgs/msg/MagneticField", "std_msgs/msg/Float64"
IMU, TEMPERATURE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/Temperature"

_CHANNELS = {
    "scalar": ("scalar/intensity", MAGNETIC_FIELD),
    "temperature": ("temperature", TEMPERATURE),
    "current": ("current", FLOAT64),
    "attitude": ("imu/data", IMU),
    "gyroscope": ("imu/data", IMU),
}
CHANNEL_TOPICS = {channel: topic for channel, (topic, _) in _CHANNELS.items()}


FIELD_UNITS = {MAGNETIC_FIELD: {f"magnetic_field.{axis}": "T" for axis in "xyz"}}
"""Units that definitions of messages state, by type and field."""


def sensor_topic(sensor: int) -> str:
    """Return the relative topic of a sensor, 1 to K."""
    return f"{sensor_stream(sensor)}/magnetic_field"


def topic_and_type(stream: str) -> tuple[str, str]:
    """Return the relative topic of a stream, a sensor's or a channel's, and the type that is recorded there."""
    if not is_channel(stream):
        return f"{stream}/magnetic_field", MAGNETIC_FIELD
    return _CHANNELS[stream] if stream in _CHANNELS else (topic_of(stream), FLOAT64)
