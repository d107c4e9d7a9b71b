"""Options of a batch: those of the job that is done for each item, and those of the whole."""

from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import create_model

from nolens.jobs.fields import FilePath, OutputFolderOptions, Scheduler, Workers
from nolens.jobs.options import JobOptions, Option, Written

One = TypeVar("One", bound=JobOptions)
_SET = (
    "a folder, a pattern such as 'raw/*.png', a list of files (.txt, one a line), or a file of "
    "many frames"
)


class BatchOptions(OutputFolderOptions):
    """What all batches have in common.

    Attributes
    ----------
    single
        Options of the job for one item.
    kind
        What the batch does, where it can be several things.
    own
        Fields of the batch that say nothing of an item's result.
    """

    record_file = "batch.json"
    single: ClassVar[type[JobOptions]]
    kind: ClassVar[str] = ""
    own: ClassVar[tuple[str, ...]] = ("items", "output", "workers", "scheduler", "device")

    items: Annotated[
        FilePath,
        Option(
            f"What is worked on, item by item: {_SET}.",
            needed="the frames (a folder, a pattern in quotes, a list or a file of many)",
            role="input",
            positional=True,
            label="Frames",
        ),
    ]
    output: Annotated[
        FilePath,
        Option(
            "Folder for the results, with batch.json (the record, with a row for each item) and "
            "manifest.sqlite (what is done). The same command again goes on where it ended.",
            needed="the folder for the results (-o FOLDER)",
            role="output",
            flag="-o",
        ),
    ]
    workers: Workers = None
    scheduler: Scheduler = None

    @property
    def inputs(self) -> dict[str, Path]:
        """Files that all items need; those of the items may be terabytes, and are not hashed."""
        files = super().inputs
        del files["items"]
        return files

    @property
    def written(self) -> tuple[Written, ...]:
        """The record; files of the items are named after them."""
        return self.in_folder({})

    def one(self, model: type[One], **values: Any) -> One:
        """Options of the job for one item, checked as that checks them."""
        given = {
            name: getattr(self, name)
            for name in self.model_fields_set
            if name in model.model_fields
        }
        options = model.model_validate({**given, **values}, by_name=True)
        options.check_together()
        return options


def batch_of(
    model: type[JobOptions], *, without: tuple[str, ...], base: type[BatchOptions], usage: str
) -> type[BatchOptions]:
    """Options of a batch: the job's own, as it declares them, and those of the whole.

    Parameters
    ----------
    model
        Options of the job for one item.
    without
        Fields that the batch fills in itself, or that make no sense in one.
    base
        With the options of the whole; its docstring is the help, after what the job does.
    usage
        The shortest way to run it.
    """
    fields: dict[str, Any] = {
        name: (field.annotation, field)
        for name, field in model.model_fields.items()
        if name not in without and name not in base.model_fields
    }
    what = (model.__doc__ or "").partition("\n")[0]
    made = create_model(
        f"Batch{model.__name__}",
        __base__=base,
        __doc__=f"For every item of a set: {what[:1].lower()}{what[1:]}\n\n{base.__doc__}",
        __module__=__name__,
        **fields,
    )
    made.single, made.usage = model, usage
    return made
