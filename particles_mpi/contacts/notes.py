"""What may be wrong with the contacts of a run, counted over all ranks and all parts of the run, and the lines that say so."""

from dataclasses import dataclass, field

NAMED = 64  # contacts without loss that are kept for the remark about them
COUNTED = "dense_steps", "crowded_steps", "late", "found", "too_fast", "lossless"


@dataclass(frozen=True)
class ContactNotes:
    """Counts of all ranks. A checkpoint holds them, so that the remarks of a run that is continued are those of the whole run.

    `dense_steps`: steps of mode `rewind` that were done in order of time; `crowded_steps`: steps in which contacts stopped the
    approach entirely; `late` of `found` collisions were found when spheres overlapped; `too_fast`: parts, on each rank, in
    which a sphere crossed more than its diameter in a step. `lossless`: contacts that took no energy because they came too soon
    after others; the `first` ones, as (time, id, id or -1 - wall), are of the step from t = `moment`.
    """

    dense_steps: int = 0
    crowded_steps: int = 0
    late: int = 0
    found: int = 0
    too_fast: int = 0
    lossless: int = 0
    moment: float = 0.0
    first: list[list[float]] = field(default_factory=list)

    def __add__(self, later: "ContactNotes") -> "ContactNotes":
        """Return the notes of two parts of a run, or of two operators."""
        counts = {name: getattr(self, name) + getattr(later, name) for name in COUNTED}
        earlier = self if self.lossless else later
        return ContactNotes(**counts, moment=earlier.moment, first=earlier.first)

    def remarks(self) -> list[str]:
        """Return the remarks for the end of the run, one line each."""
        lines = []
        if self.dense_steps:
            lines.append(
                f"{self.dense_steps} steps had more contacts than passes could put in order: they were done in order of time"
            )
        if self.crowded_steps:
            steps = f"in {self.crowded_steps} steps some contacts stopped the approach entirely, as if e = 0"
            lines.append(f"collapsing crowds: {steps}")
        if self.lossless:
            lines.append(
                f"inelastic collapse: {self.lossless} contacts took no energy, because they came too soon after others, "
                f"the first in the step from t = {self.moment:g} among {self.cluster()}"
            )
        if self.too_fast:
            lines.append(
                "spheres crossed more than their diameter in a step, and may have collided in a wrong order: shorten time.step"
            )
        if self.late:
            overlapped = f"collisions found late, when spheres overlapped: {self.late} of {self.found}"
            lines.append(f"{overlapped}; shorter steps have fewer, mode event has none")
        return lines

    def cluster(self) -> str:
        """Return the particles and walls among which the first contacts without loss took place, in words."""
        pairs = [(int(a), int(b)) for _, a, b in self.first]
        cluster = set(pairs[0])
        for pair in pairs:  # in order of time: a cluster grows from its first pair
            if cluster & {member for member in pair if member >= 0}:
                cluster |= set(pair)
        ids, walls = [str(k) for k in sorted(cluster) if k >= 0], [str(-1 - k) for k in sorted(cluster) if k < 0]
        return f"particles {', '.join(ids)}" + (f" and wall {', '.join(walls)}" if walls else "")
