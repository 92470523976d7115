"""What a study is, and how any of them runs: grid, jobs, table, page."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from multicontact_control.errors import check_all, ConfigError, counted
from multicontact_control.experiment.study.cache import prepare_job_folder
from multicontact_control.experiment.study.execute import (
    count_finished,
    dask_client,
    JobRun,
    run_jobs,
    workers_at_once,
)
from multicontact_control.experiment.study.jobs import JobResult, JobT
from multicontact_control.experiment.study.page import Page, write_study_page
from multicontact_control.experiment.study.table import terminal_table, write_table
from multicontact_control.experiment.terminal import terminal
from rich.console import Console
from rich.markup import escape

ContentT = TypeVar('ContentT')


class Study(ABC, Generic[JobT, ContentT]):
    """A grid of jobs, what is measured in each, and what is shown of all of them."""

    title: ClassVar[str]  # left of the progress bar
    name: ClassVar[str]  # of its page and its figure
    unit: ClassVar[str] = 'runs'  # what its jobs are called

    def check(self) -> None:
        """Check the options; ConfigError with all that are not acceptable."""

    @abstractmethod
    def grid(self) -> Mapping[str, Sequence[Any]]:
        """Return what is varied, and its values."""

    @abstractmethod
    def jobs(self) -> list[JobT]:
        """Return every job; one may come twice. ConfigError if one is not acceptable."""

    def further(self, run: JobRun[JobT]) -> list[JobT]:
        """Return what else is to be run, now that the jobs have been."""
        return []

    @staticmethod
    @abstractmethod
    def measure(job: Any) -> JobResult:
        """Run a job; workers must be able to import what does."""

    @abstractmethod
    def content(self, run: JobRun[JobT]) -> ContentT:
        """Return what came out of the jobs, the same whatever ran them."""

    def tables(self, content: ContentT, run: JobRun[JobT]) -> Mapping[str, Any]:
        """Return what is written, as for `write_table`, by file name; one JSON file if alone."""
        return {f'{self.name}.json': content}

    @abstractmethod
    def page(self, content: ContentT, folder: Path) -> Page:
        """Return what is shown; the finished jobs are in the folder."""

    def folder(self) -> Path:
        """Return where the results go unless the user says otherwise."""
        return Path('runs') / self.title

    def headline(self) -> str:
        """Return in one line what is run."""
        sizes = (counted(len(values), name) for name, values in self.grid().items())
        return f'{self.title}: {", ".join(sizes)}'


def check_seeds(count: int) -> None:
    """Check a number of seeds; ConfigError if there is none."""
    if count < 1:
        raise ConfigError('seeds', 'at least 1', count)


@dataclass(frozen=True)
class StudyOptions:
    """How a study is run."""

    out: Path | None = None  # folder of the results; None for the study's own
    jobs: int = 0  # at once on this machine, 0 for every core
    dask: str = ''  # address of a Dask scheduler to use instead
    dry_run: bool = False  # only say what would be run
    overwrite: bool = False  # run finished jobs again

    def check(self) -> None:
        """Check what can be checked without doing anything; ConfigError if it is bad."""
        if self.jobs < 0:
            raise ConfigError('jobs', 'a whole number >= 0', self.jobs)
        if self.dask and self.jobs:
            raise ConfigError('jobs', 'nothing together with --dask, whose workers decide',
                              self.jobs)


def run_study(
    study: Study[JobT, ContentT], options: StudyOptions, console: Console | None = None,
) -> ContentT | None:
    """
    Run a study, write its files, and show and return what came out; None of a dry run.

    Raises
    ------
    ConfigError
        If study or options are not acceptable, before anything is run.
    RunError
        If a worker dies; what is finished is kept.

    """
    console = console or terminal()
    run = run_study_jobs(study, options, console)
    if run is None:
        return None
    content = study.content(run)
    report_study(study, content, run, console)
    return content


def run_study_jobs(
    study: Study[JobT, ContentT], options: StudyOptions, console: Console,
) -> JobRun[JobT] | None:
    """Run the jobs of a study that have no result yet; None of a dry run. See `run_study`."""
    check_all(options.check, study.check)
    jobs, folder = study.jobs(), options.out or study.folder()
    with dask_client(options.dask) as client:
        if not options.dry_run:
            prepare_job_folder(folder, overwrite=options.overwrite,
                               results=[f'{study.name}.json', f'{study.name}.html'])
        runs, finished = count_finished(jobs, folder)
        console.print(study.headline(), highlight=False, markup=False)
        if options.dry_run:
            for name, values in study.grid().items():
                console.print(f'  {name}: {", ".join(map(str, values))}', highlight=False,
                              markup=False, soft_wrap=True)
        console.print(
            f'{counted(runs, study.unit)}, {0 if options.overwrite else finished} of them '
            f'finished before; {workers_at_once(options.jobs, client)} at once', highlight=False)
        if options.dry_run:
            return None

        def run_all(some: Sequence[JobT]) -> JobRun[JobT]:
            return run_jobs(some, folder, study.measure, workers=options.jobs, client=client,
                            console=console, title=study.title)

        run = run_all(jobs)
        further = study.further(run)
        return replace(run, keys={**run.keys, **run_all(further).keys}) if further else run


def report_study(
    study: Study[JobT, ContentT], content: ContentT, run: JobRun[JobT], console: Console,
) -> None:
    """Write the files of a study and show what came out."""
    paths = [write_table(table, run.folder / name)
             for name, table in study.tables(content, run).items()]
    page = study.page(content, run.folder)
    for section in page.sections:
        if section.listing is not None and section.in_terminal:
            console.print(terminal_table(section.heading, section.listing, console.width))
    for text in page.warnings:
        console.print(f'[red]{escape(text)}[/red]', highlight=False)
    for text in page.findings:
        console.print(f'- {escape(text)}', highlight=False)
    paths += write_study_page(page, run.folder / study.name)
    for path in paths:
        console.print(f'results in {path}', highlight=False, soft_wrap=True)
