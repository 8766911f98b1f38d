from setuptools import find_packages, setup

NAME = "bike_sim"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={
        NAME: [
            "py.typed",
            "config/vehicles/*.yaml",
            "config/vehicles/variants/*.yaml",
            "config/vehicles/variants/parts/*",
            "config/courses/*.yaml",
            "config/disturbances/*.yaml",
            "config/courses/*.csv",
            "config/tracks/*.yaml",
            "config/validation/*.yaml",
            "config/middleware/*.xml",
            "config/middleware/fastdds3/*.xml",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="bike lab maintainers",
    maintainer_email="noreply@two-wheeler-lab.invalid",
    description="Bicycle physics, courses, and the simulator and recorder nodes.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "race_node = bike_sim.ros.race_node:main",
            "record = bike_sim.ros.record:main",
            "sim_node = bike_sim.ros.sim_node:main",
        ],
    },
)
