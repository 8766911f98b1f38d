"""Isolation of nodes: discovery on this machine, domains, end with the parent process. Imports no ROS.

    python -m bike_sim.ros.isolation

prints the variables that a shell must export so that programs started from it, such as `ros2`, find the nodes.
"""

from __future__ import annotations

import itertools
import os
import shlex
import socket
from collections.abc import MutableMapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Final

DISCOVERY_VARIABLE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
DOMAIN_VARIABLE: Final = "ROS_DOMAIN_ID"
MIDDLEWARE_VARIABLE: Final = "RMW_IMPLEMENTATION"
_FAST_DDS_2: Final = os.environ.get("ROS_DISTRO", "jazzy") in ("humble", "iron", "jazzy")
PROFILES_VARIABLE: Final = "FASTRTPS_DEFAULT_PROFILES_FILE" if _FAST_DDS_2 else "FASTDDS_DEFAULT_PROFILES_FILE"
"""Names the settings of Fast DDS; other middleware takes no notice."""
_MIDDLEWARE: Final = Path(__file__).parents[1] / "config" / "middleware"
THIS_MACHINE: Final = (_MIDDLEWARE if _FAST_DDS_2 else _MIDDLEWARE / "fastdds3") / "this_machine.xml"
"""Fast DDS 3, of Kilted, reads other names of elements."""
NETWORK: Final = THIS_MACHINE.with_name("network.xml")
LOCAL_PROFILES: Final = f"DEFAULT_FAST{'RTPS' if _FAST_DDS_2 else 'DDS'}_PROFILES.xml"
"""Settings of a user in the working directory, which Fast DDS reads on its own."""

LOCALHOST: Final = "LOCALHOST"
AS_PROFILES_SAY: Final = "SYSTEM_DEFAULT"
"""Discovery range that leaves all to the settings of the middleware."""

FIRST_DOMAIN: Final = 1
LAST_DOMAIN: Final = 101
"""Domains that are lent out. 0 is everyone's default; above 101 ports collide with those that the kernel hands out."""
FIRST_PORT: Final = 7400
PORTS_PER_DOMAIN: Final = 250
"""UDP ports of domain d begin at FIRST_PORT + d PORTS_PER_DOMAIN (OMG DDSI-RTPS 2.5, 9.6.2.3)."""


def prepare_discovery(environment: MutableMapping[str, str] = os.environ) -> None:
    """Let nodes be found on this machine only, and soon, unless the user says otherwise.

    LOCALHOST alone is not enough: with it, Fast DDS listens on every interface. Its settings in `THIS_MACHINE` keep
    to 127.0.0.1, and need a range that leaves it to them. Other middleware, and settings of the user's own, get
    LOCALHOST.

    Args:
        environment: of the process that will have the nodes; it must not have had one yet.
    """
    fast_dds = (environment.get(MIDDLEWARE_VARIABLE) or "rmw_fastrtps_cpp").startswith("rmw_fastrtps")
    profiles = environment.get(PROFILES_VARIABLE)
    own_settings = profiles not in (None, str(THIS_MACHINE), str(NETWORK)) or Path(LOCAL_PROFILES).exists()
    if own_settings or not fast_dds:
        environment.setdefault(DISCOVERY_VARIABLE, LOCALHOST)
    elif environment.get(DISCOVERY_VARIABLE, LOCALHOST) in (LOCALHOST, AS_PROFILES_SAY, ""):
        environment[DISCOVERY_VARIABLE] = AS_PROFILES_SAY
        environment[PROFILES_VARIABLE] = str(THIS_MACHINE)
    else:
        environment[PROFILES_VARIABLE] = str(NETWORK)


_leases = itertools.count()
"""Numbers of this process' leases."""
_STRIDE: Final = 10
"""Domains between a lease and the next of the same process: those beside it are of processes started with it."""


class DomainLease(AbstractContextManager["DomainLease"]):
    """A ROS domain that no other lease on this machine has, held until `close` or the end of the process.

    A lease is the name of a socket without connections. The kernel grants each name once, across all users, and
    releases it when the process is gone. Unlike a file in a shared folder it cannot be prepared by another user, and it
    leaves nothing behind. Names, as ports, are those of the network namespace.

    Attributes:
        domain_id: the domain.
    """

    def __init__(self, family: str = "bike_ros_domain") -> None:
        """Take a free domain, preferably one without running nodes.

        The first one that is tried depends on the process and moves on with each lease.

        Args:
            family: which leases exclude each other.

        Raises:
            OSError: every domain is taken.
        """
        count = LAST_DOMAIN - FIRST_DOMAIN + 1
        first = os.getpid() + _STRIDE * next(_leases)
        domains = [FIRST_DOMAIN + (first + k) % count for k in range(count)]
        inhabited = _inhabited_domains()
        for domain_id in sorted(domains, key=lambda domain: domain in inhabited):
            name = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            try:
                name.bind(f"\0{family}_{domain_id}")
            except OSError:
                name.close()
                continue
            self._name = name
            self.domain_id = domain_id
            return
        raise OSError(f"all ROS domains from {FIRST_DOMAIN} to {LAST_DOMAIN} are taken by running rides and trainings")

    def close(self) -> None:
        """Give the domain back."""
        self._name.close()

    def __exit__(self, *_: object) -> None:
        """Give the domain back."""
        self.close()


def _inhabited_domains() -> set[int]:
    """Return the domains in which nodes are running already, such as those started by hand."""
    try:
        lines = Path("/proc/self/net/udp").read_text().splitlines()[1:]
    except OSError:
        return set()
    ports = (int(line.split()[1].rpartition(":")[2], 16) for line in lines)
    return {(port - FIRST_PORT) // PORTS_PER_DOMAIN for port in ports}


# --------------------------------------------------------------------------------------------------------------- parent

PARENT_VARIABLE: Final = "BIKE_PARENT"
"""Number of the process that a node is to end with; not set where a node is started by hand."""

PARENT_PERIOD: Final = 0.25
"""Wall-clock time between two looks at the parent, s."""


def end_with_this_process(environment: MutableMapping[str, str]) -> None:
    """Let a node that is started with an environment end with this process."""
    environment[PARENT_VARIABLE] = str(os.getpid())


def parent_is_gone() -> bool:
    """Return whether this process has lost the one that it is to end with.

    It is polled. The kernel's own signal for this (PR_SET_PDEATHSIG) comes when the thread ends that
    started the process, and would end the nodes of a program that starts them in a thread; the number of the parent is
    that of the program. It is also right where the parent was gone before the first look.
    """
    parent = os.environ.get(PARENT_VARIABLE)
    return parent is not None and parent != str(os.getppid())


# -------------------------------------------------------------------------------------------------------------- shell


def _print_exports() -> None:
    environment = dict(os.environ)
    prepare_discovery(environment)
    for variable in (DISCOVERY_VARIABLE, PROFILES_VARIABLE):
        if variable in environment:
            print(f"export {variable}={shlex.quote(environment[variable])}")


if __name__ == "__main__":
    _print_exports()
