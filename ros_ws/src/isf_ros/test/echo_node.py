"""A process that sends back every contour, correction and result it receives; started by test_conversion.py."""

import rclpy
from isf_msgs.msg import Contour, ContourCorrection, ContourResult
from isf_ros import process, qos
from isf_ros.conversion import (
    contour_from_message,
    contour_to_message,
    correction_from_message,
    correction_to_message,
    result_from_message,
    result_to_message,
)
from rclpy.signals import SignalHandlerOptions


def main() -> None:
    ending = process.Ending()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("echo")
    for kind, name, read, write in (
        (Contour, "contour", contour_from_message, contour_to_message),
        (ContourCorrection, "correction", correction_from_message, correction_to_message),
        (ContourResult, "result", result_from_message, result_to_message),
    ):
        back = node.create_publisher(kind, f"{name}_back", qos.LATCHED)

        def echo(message: object, back: object = back, read: object = read, write: object = write) -> None:
            back.publish(write(read(message)))  # type: ignore[attr-defined,operator]

        node.create_subscription(kind, name, echo, qos.LATCHED)
    try:
        process.spin(node, ending)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
