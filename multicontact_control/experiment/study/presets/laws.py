"""What `multicontact study laws` says beside its table: what each law is good for."""

from __future__ import annotations

import math

from multicontact_control.experiment.study.study import Results, Study
from multicontact_control.experiment.study.table import worst

NEAR_BEST = 1.25  # times the best figure, that counts as about as good
FAR_FROM_BEST = 3.0
LEAST = {'rest_rms_n': 0.02, 'neighbour_n': 0.2, 'push_off_s': 0.01, 'overshoot_percent': 3.0}


class LawsStudy(Study):
    """Force laws in everything that a contact may meet."""

    def findings(self, results: Results) -> list[str]:
        """Return in plain sentences what each law is good for, on each plant."""
        found, frame = [], results.frame
        for plant, here in frame.groupby('plant', sort=False):
            task = here[here['part'] == 'task'].groupby('preset', sort=False)['stable']
            stable = task.all()
            good: dict[str, list[str]] = {str(law): [] for law in stable.index}
            bad: dict[str, list[str]] = {str(law): [] for law in stable.index}
            for column in self.config.columns:
                if not column.rank:
                    continue
                part = here[here['part'] == column.part]
                values = worst(part, column.value).groupby(part['preset'], sort=False).median()
                values = values[stable.reindex(values.index, fill_value=False)]
                known = values[values < math.inf]
                best = max(known.min(), LEAST.get(column.value, 0.0)) if len(known) else math.inf
                for law, value in values.items():
                    if value <= NEAR_BEST * best:
                        good[str(law)].append(column.rank)
                    elif not value <= FAR_FROM_BEST * best:
                        number, _, unit = column.name.rpartition(' ')
                        bad[str(law)].append(
                            f'{column.rank} ({column.scale * value:.{column.digits}f} '
                            f'{column.name.partition("[")[2].rstrip("]")})')
            for law, whole in stable.items():
                counts = task.agg(['sum', 'count']).loc[law]
                found.append(f'{plant}, {law}: ' + (
                    f'good at {", ".join(good[str(law)]) or "nothing above all"}'
                    + (f'; not at {", ".join(bad[str(law)])}' if bad[str(law)] else '')
                    if whole else f'stable in {counts["sum"]} of {counts["count"]} runs of the '
                    'task') + '.')
        return found
