"""Classes of messages, and the names of their types."""

from importlib import import_module
from typing import Any


def type_name(kind: Any) -> str:
    """Return the name of a message's class, such as ``sensor_msgs/msg/Imu``."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def message_class(name: str) -> Any:
    """Return the class of messages of a type, such as ``sensor_msgs/msg/Imu``; None where it is not installed."""
    package, *_, message = name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), message)
    except (ImportError, AttributeError, ValueError):
        return None
