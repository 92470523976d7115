"""Jobs that may kill the process that runs them; in a module that workers can import."""

from dataclasses import dataclass
import os
import signal


@dataclass(frozen=True)
class MortalJob:
    number: int
    deadly: bool = False

    def key(self):
        return f'job{self.number}'

    def run(self):
        if self.deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        return {'process': os.getpid(), 'threads': os.environ.get('OMP_NUM_THREADS')}
