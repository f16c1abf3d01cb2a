"""`keys`: certificates for mutual TLS."""

from pathlib import Path

from deploy.live.certificates import AUTHORITY, make_keys
from deploy.scenario import resolve
from protocol.access import OPERATOR, WATCHER, WORLD
from protocol.settings import BadSetting


def keys(names: list[str], scenario: str | None, into: Path, hosts: tuple[str, ...], days: int, force: bool, in_git: bool = False) -> int:
    """Make certificates and list them: for these names, or for the world, the watchers, the operator and all members of a scenario."""
    if bool(names) == bool(scenario):
        raise BadSetting("keys: give either names, such as `covey keys s1 s2 world monitor`, or --scenario NAME")
    if not 1 <= days <= 36500:
        raise BadSetting(f"--days {days}: should be a number of days from 1 to 36500")
    owners = names or [WORLD, WATCHER, OPERATOR, *resolve(str(scenario)).members]
    made = make_keys(owners, into, hosts, days=days, force=force, in_git=in_git)
    print(f"{len(made)} certificate{'s' * (len(made) != 1)} in {into}: {', '.join(file.stem for file in made)}")
    print(f"{into / AUTHORITY}.key signs more of them: keep it off the machines of the swarm")
    return 0
