"""``published:`` in an experiment file: numbers from a publication that the results are held against."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from slamcmp.registry import did_you_mean

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

    from slamcmp.support.configuration.config_errors import ConfigErrors
    from slamcmp.support.configuration.yaml_source import KeyPath

Tolerance = Annotated[float, Field(gt=0)]


class PublishedRow(BaseModel):
    """What the publication says about one estimator."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    label: str = Field(description="Label of the back end that repeats it")
    at: dict[str, Any] = Field(
        default_factory=dict, description="Grid point: swept path and value; needed where there is a sweep"
    )
    values: dict[str, float] = Field(
        min_length=1, description="Metric (a column of the trials table or ensemble_…) and published value"
    )


class PublishedOrder(BaseModel):
    """From best to worst, judged pair by pair on paired seeds.

    How: :mod:`slamcmp.results.judgements.verdict`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    metric: str = Field(description="Lower is better")
    labels: list[str] = Field(min_length=2, description="Labels of back ends, from best to worst")
    worst_factor: float | None = Field(
        None, gt=1, description="The last one's value is at least so many times the one before it"
    )


class Published(BaseModel):
    """A publication's numbers, how near is near enough, and the order it found."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    source: str = Field(min_length=1, description="Who published the numbers, and where")
    rows: list[PublishedRow] = Field(default_factory=list)
    tolerance: dict[str, Tolerance] = Field(
        default_factory=dict,
        description="Metric and relative tolerance; values of a metric without one are shown, not judged",
    )
    order: list[PublishedOrder] = Field(default_factory=list)


def published_keys(errors: Iterable[ErrorDetails]) -> dict[KeyPath, Iterable[str]]:
    """The valid keys of the section and of every part of it in which an error lies."""
    known: dict[KeyPath, Iterable[str]] = {("published",): Published.model_fields}
    for name, model in (("rows", PublishedRow), ("order", PublishedOrder)):
        for details in errors:
            if details["loc"][:2] == ("published", name):
                known[details["loc"][:3]] = model.model_fields
    return known


def check_published(
    errors: ConfigErrors,
    published: Published,
    labels: Sequence[str] | None,
    swept: Mapping[str, Sequence[Any]],
) -> None:
    """Note every label, metric and grid point that is not there; no ``labels``: they are not known."""
    # They load every metric; most experiments do not need them.
    from slamcmp.metrics import metric_columns
    from slamcmp.results.judgements.ensemble import ENSEMBLE_METRICS

    metrics = [*metric_columns(), *ENSEMBLE_METRICS]

    def check_metric(name: str, path: KeyPath, *, key: bool = False) -> None:
        if name not in metrics:
            what = f"published: there is no metric {name!r}{did_you_mean(name, metrics)}"
            errors.add(path, what, key=key)

    def check_label(name: str, path: KeyPath) -> None:
        if labels is not None and name not in labels:
            what = f"published: no back end has the label {name!r}{did_you_mean(name, labels)}"
            errors.add(path, what)

    for index, row in enumerate(published.rows):
        place: KeyPath = ("published", "rows", index)
        check_label(row.label, (*place, "label"))
        for name in row.values:
            check_metric(name, (*place, "values", name), key=True)
        for path in swept.keys() - row.at.keys():
            errors.add(place, f"published: {path} is swept; 'at:' has to say which of its values is meant")
        for path, value in row.at.items():
            if value not in swept.get(path, ()):
                errors.add((*place, "at", path), f"published: the sweep has no {path} = {value!r}")
    for name in published.tolerance:
        check_metric(name, ("published", "tolerance", name), key=True)
    for index, order in enumerate(published.order):
        check_metric(order.metric, ("published", "order", index, "metric"))
        for position, name in enumerate(order.labels):
            check_label(name, ("published", "order", index, "labels", position))
