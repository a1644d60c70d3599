"""The package for colcon, and for pip beside ROS 2 packages that came by pip."""

from setuptools import setup

setup(
    name="armbridge_ros2",
    version="0.2.0",
    description="Joins an armbridge server to the ROS graph.",
    license="Apache-2.0",
    packages=["armbridge_ros2"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/armbridge_ros2"]),
        ("share/armbridge_ros2", ["package.xml"]),
    ],
    install_requires=["cbor2>=5", "websockets>=14"],
    python_requires=">=3.10",
    entry_points={"console_scripts": ["bridge = armbridge_ros2.bridge:main"]},
)
