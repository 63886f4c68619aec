"""What a request for a diagnosis names: catalogue, asset, baselines, recordings, and what is remembered of sensors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from jointplay.app.errors import BadFieldError, DeletedError, UnknownMeasurementError
from jointplay.app.jobs import tasks
from jointplay.app.jobs.following import MOST_LESSONS
from jointplay.app.schemas.resources import DiagnosisRequest
from jointplay.app.shelves.catalogues import CatalogueShelf, Offer
from jointplay.app.speeds import speeds_of
from jointplay.app.storage.asset_rows import AssetRow
from jointplay.app.storage.assets import Assets, measurements_of
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.remembered import Remembered
from jointplay.app.storage.repairs import is_between
from jointplay.app.storage.rows import MeasurementRow
from jointplay.app.storage.standings import made_of, moments_of
from jointplay.app.storage.store import Store
from jointplay.catalogue.diagnosing.question import MOST_TOGETHER
from jointplay.catalogue.signals.sensors import match_by_name


@dataclass(frozen=True)
class Asked:
    """What a request for a diagnosis names.

    Parameters
    ----------
    offer : Offer
        Its catalogue.
    asset : AssetRow or None
        Its asset.
    question : DiagnosisTask
        What a worker is told of them.
    baselines : tuple of str
        Ids of the recordings of the asset in order that it is compared with.
    remembered : bool
        Whether its sensors are those of the asset's last recording with the same columns.
    """

    offer: Offer
    asset: AssetRow | None
    question: tasks.DiagnosisTask
    baselines: tuple[str, ...] = ()
    remembered: bool = False


@dataclass(frozen=True)
class Questions:
    """Finds what requests for diagnoses name, in a store and on a shelf of catalogues.

    Parameters
    ----------
    store : Store
    shelf : CatalogueShelf
    """

    store: Store
    shelf: CatalogueShelf

    def about_stored(self, request: DiagnosisRequest) -> tuple[list[MeasurementRow], Asked, DiagnosisRequest]:
        """Return the measurements that a request names, what else it names, and the request with what is remembered.

        Which column is which sensor is taken from what was said of a recording last, or else of the asset's last one
        with the same columns, where the request does not say it.

        Raises
        ------
        AppError
            When something of that does not exist, or breaks a rule.
        """
        asked = self.about(request)
        rows = self.measurements_of(request, asked.asset)
        if self.may_remember(asked, request):
            columns = {row.id: columns_of(row.summary) for row in rows}
            asked, request = self.with_remembered(asked, request, columns)
        return rows, asked, request

    def may_remember(self, asked: Asked, request: DiagnosisRequest) -> bool:
        """Return whether a request leaves to its asset which column is which sensor, and something is known of that."""
        if asked.asset is None or "mapping" in request.model_fields_set:
            return False
        return Remembered(self.store.database).has_mappings(asked.asset.external_id)

    def with_remembered(
        self, asked: Asked, request: DiagnosisRequest, columns: Mapping[str, Sequence[str]]
    ) -> tuple[Asked, DiagnosisRequest]:
        """Return a question and its request with the sensors that are remembered of recordings with these columns.

        Raises
        ------
        BadFieldError
            When a column is one sensor in one of them, and none or another one in another.
        """
        assert asked.asset is not None
        mapping: dict[str, str] = {}
        sensors: dict[str, str] = {}
        for key, names in columns.items():
            known = self.remembered_sensors(asked.asset.external_id, key, names)
            mapping |= known
            # Of columns without a name of a sensor nothing is known where nothing was said of any.
            others = dict.fromkeys(names if known else (), "")
            found = others | match_by_name(names, asked.offer.machine) | known
            for name, sensor in found.items():
                if sensors.setdefault(name, sensor) != sensor:
                    said = " in one of them and ".join(sorted(each or "no sensor" for each in (sensors[name], sensor)))
                    rule = "in another, as was said of them: diagnose each by itself"
                    raise BadFieldError(f"mapping: column {name[:80]}: is {said} {rule}", field="mapping")
        if not mapping:
            return asked, request
        question = replace(asked.question, mapping=mapping)
        return replace(asked, question=question, remembered=True), request.model_copy(update={"mapping": mapping})

    def measurements_of(self, request: DiagnosisRequest, asset: AssetRow | None) -> list[MeasurementRow]:
        """Return the measurements that a request names, or those of its asset in a window of time.

        Raises
        ------
        UnknownMeasurementError
            When one does not exist.
        BadFieldError
            When the request names them in no way, or in two; there are none, or too many, in the window; or a joint of
            the asset was repaired between them.
        """
        rows = self._named(request, asset)
        if asset is not None and len(rows) > 1:
            self._check_one_state(rows, asset, "measurements" if request.since is None else "since")
        return rows

    def _check_one_state(self, rows: Sequence[MeasurementRow], asset: AssetRow, field: str) -> None:
        """Refuse recordings of an asset between which a joint was repaired: one answer is of one state."""
        with self.store.database.reading() as session:
            made = moments_of(session, asset.external_id, [row.id for row in rows])
        moments = [made.get(row.id, row.measured_at) for row in rows]
        for found in Findings(self.store.database).of_asset(asset, MOST_LESSONS, damaged=[]):
            repaired = sorted(name for name, told in found.joints.items() if told.get("repaired"))
            if repaired and is_between([found.at], moments):
                said = f"joint {', '.join(repaired)} of asset {asset.external_id} was repaired on {found.at:%Y-%m-%d}"
                rule = "between them: must be of one state"
                raise BadFieldError(f"{field}: {said}, {rule}", field=field)

    def _named(self, request: DiagnosisRequest, asset: AssetRow | None) -> list[MeasurementRow]:
        """Return the measurements that a request names, in whatever way."""
        given = [name for name in ("measurement", "measurements", "since") if getattr(request, name) is not None]
        if len(given) != 1:
            said = f"{' and '.join(given) or 'measurement'}: give one of measurement, measurements, or since with asset"
            raise BadFieldError(said, field=given[-1] if given else "measurement")
        if request.until is not None and request.since is None:
            raise BadFieldError("until: needs since", field="until")
        if request.speeds is not None and request.measurements is None:
            raise BadFieldError("speeds: needs measurements", field="speeds")
        if request.measurement is not None:
            return [self.store.measurement(request.measurement)]
        if request.speed not in (None, ""):
            rule = "is for one measurement alone: with measurements, give speeds; in a window speeds are estimated"
            raise BadFieldError(f"speed: {request.speed}: {rule}", field="speed")
        in_order = () if asset is None else asset.in_order
        known = {self.store.measurement(key).sha256 for key in in_order}
        if request.measurements is not None:
            if request.speeds is not None and len(request.speeds) != len(request.measurements):
                counts = f"{len(request.speeds)} for {len(request.measurements)} measurements"
                raise BadFieldError(f"speeds: {counts}: must be one for each, or none", field="speeds")
            named = [self.store.measurement(key) for key in request.measurements]
            for row in named:
                if row.sha256 in known:
                    said = f"measurements: {row.id}: is the baseline that the others are compared with"
                    raise BadFieldError(said, field="measurements")
            return named
        if asset is None:
            raise BadFieldError("since: needs an asset", field="asset")
        assert request.since is not None
        window = (request.since, request.until)
        if request.until is not None and request.until <= request.since:
            raise BadFieldError(f"until: {request.until.isoformat()}: must be after since", field="until")
        # What the others are compared with is no evidence of the present state.
        among = measurements_of(asset.external_id)
        with self.store.database.reading() as session:
            made = made_of(session, asset.external_id).values()
        names = Counter(sha256 for sha256, _ in made)
        # What was sent again in the window was made before it.
        known |= {sha256 for sha256, moment in made if names[sha256] > 1 and moment < request.since}
        rows = self.store.measurements_between(among, *window, MOST_TOGETHER + 1, without=known)
        if not 1 <= len(rows) <= MOST_TOGETHER:
            count = len(rows) if len(rows) <= MOST_TOGETHER else f"more than {MOST_TOGETHER}"
            raise BadFieldError(
                f"since: {count} measurements of asset {asset.external_id} that are no baselines: must be 1 to "
                f"{MOST_TOGETHER}",
                field="since",
            )
        return rows

    def about(self, request: DiagnosisRequest) -> Asked:
        """Return what a request names besides its measurement.

        Raises
        ------
        AppError
            When something of that does not exist, or breaks a rule.
        """
        given = request.model_dump(include={"speed", "speeds", "measurements"})
        speeds = speeds_of(given) if request.since is None else ()
        offer = self.shelf.find(request.catalogue)
        asset = self.asset_of(request.asset, offer.machine.name)
        in_order = [] if asset is None else self.baselines_of(asset, request.measurement)
        baselines = () if asset is None else self.files_of(asset.external_id, in_order)
        limits_um = {} if asset is None else asset.limits_um
        mapping, prior = dict(request.mapping), request.prior.model_dump()
        place = (str(offer.path), offer.stamp)
        question = tasks.DiagnosisTask(
            *place, speeds, request.effort, request.mode, mapping, prior, baselines, limits_um
        )
        return Asked(offer, asset, question, tuple(row.id for row in in_order))

    def asset_of(self, name: str | None, machine: str) -> AssetRow | None:
        """Return the asset of a name, where one is given.

        Raises
        ------
        UnknownAssetError
            When there is none of this id.
        BadFieldError
            When the asset is another machine than the catalogue's.
        """
        if name is None:
            return None
        found = Assets(self.store.database).asset(name)
        if found.machine != machine:
            said = f"asset: {name}: is a {found.machine}; the catalogue is of {machine}"
            raise BadFieldError(said, field="asset")
        return found

    def baselines_of(self, asset: AssetRow, measurement: str | None) -> list[MeasurementRow]:
        """Return the baselines of an asset, without the measurement itself."""
        rows = [self.store.measurement(key) for key in asset.in_order if key != measurement]
        own = None
        if rows and measurement is not None:
            with suppress(UnknownMeasurementError, DeletedError):  # it is on its way, with this question
                own = self.store.measurement(measurement).sha256
        return [row for row in rows if row.sha256 != own]

    def remembered_sensors(self, asset: str, measurement: str, columns: Sequence[str]) -> dict[str, str]:
        """Return sensors of columns as was said of a recording of an asset, or else of its last one with such columns.

        Nothing where nothing was said.
        """
        read = Assets(self.store.database).as_read(asset, [measurement]).get(measurement)
        if read is not None:
            return dict(read.mapping)
        return Remembered(self.store.database).mapping(asset, columns) or {}

    def files_of(self, asset: str, baselines: Sequence[MeasurementRow]) -> tuple[tasks.BaselineFile, ...]:
        """Return what a worker needs to read baselines of an asset."""
        read = Assets(self.store.database).as_read(asset, [row.id for row in baselines])
        files = []
        for row in baselines:
            own = read.get(row.id)
            said = (None, None) if own is None else (own.mapping, own.speed)
            files.append((str(self.store.path_of(row.sha256)), row.name, row.told, *said))
        return tuple(files)


def columns_of(summary: Mapping[str, Any]) -> list[str]:
    """Return the names of the columns of a recording."""
    return [channel["name"] for channel in summary["channels"]]
