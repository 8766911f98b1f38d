from setuptools import find_packages, setup

NAME = "bike_policy"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "policies/*/*", "laps/*.csv"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="bike lab maintainers",
    maintainer_email="noreply@two-wheeler-lab.invalid",
    description="Observation, action, policy bundles, and the node that drives with them.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [f"{name} = bike_policy.{name}:main" for name in ("drive", "estimate", "joy")],
    },
)
