"""One call of `deltaid fleet`: what all of its steps have in common."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from deltaid.fleets.cluster import done
from deltaid.fleets.fleet import Fleet
from deltaid.fleets.gather_plan import Ways
from deltaid.fleets.known import Known
from deltaid.fleets.place import Place

if TYPE_CHECKING:
    from distributed import Client

Say = Callable[[str], None]
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Call:
    """A call.

    Attributes:
        fleet: what there is.
        place: the fleet's folder.
        ways: how recordings are gathered.
        known: what earlier calls have come to.
        client: of workers, which start when they are asked for.
        say: told of every step.
    """

    fleet: Fleet
    place: Place
    ways: Ways
    known: Known
    client: "Callable[[], Client]"
    say: Say

    def done(
        self,
        words: tuple[str, str],
        work: Callable[..., _Result],
        jobs: Sequence[_Item],
        failed: Callable[[_Item, str], _Result],
    ) -> Iterator[_Result]:
        """Jobs that are left, done by workers, in whatever order.

        Args:
            words: what is said, such as 'gathered' 'recordings'.
            work: a job, and the fleet's folder as `place`, to a result.
            failed: the result of a job that nobody could do.
        """
        if not jobs:
            return
        self.say(f"{words[0]} 0 of {len(jobs)} {words[1]}")
        task = partial(work, place=self.place)
        for k, one in enumerate(done(self.client(), task, jobs, failed), start=1):
            yield one
            self.say(f"{words[0]} {k} of {len(jobs)} {words[1]}")
