"""The front door of the package: a survey with or without metal."""

from __future__ import annotations

from goldfield.site import Site
from goldfield.survey import procedure
from goldfield.survey.data import Free, SurveyData, SurveyResult
from goldfield.survey.metal_choice import survey_with_metal


def survey(
    site: Site, data: SurveyData, free: frozenset[Free] | None = None, progress: procedure.Progress | None = None
) -> SurveyResult:
    """Find beacons and sensor as they are, and with `Free.FIELD` the metal of the room.

    See `goldfield.survey.procedure.survey` for the parameters and errors.
    """
    if free is not None and Free.FIELD in free:
        return survey_with_metal(site, data, free, progress)
    return procedure.survey(site, data, free, progress)
