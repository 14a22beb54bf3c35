"""The front door of the package: a survey with or without metal."""

from __future__ import annotations

from goldfield.site import Site
from goldfield.survey import procedure
from goldfield.survey.checks import check_arguments
from goldfield.survey.data import Free, SurveyData, SurveyResult
from goldfield.survey.metal_choice import survey_with_metal
from goldfield.survey.repeats import counted_once


def survey(
    site: Site, data: SurveyData, free: frozenset[Free] | None = None, progress: procedure.Progress | None = None
) -> SurveyResult:
    """Find beacons and sensor as they are, and with `Free.FIELD` the metal of the room.

    Epochs that repeat another one to the last digit count once. See `goldfield.survey.procedure.survey` for the
    parameters and errors.
    """
    check_arguments(site, data, free)
    once = counted_once(data)
    if free is not None and Free.FIELD in free:
        return once.all_told(survey_with_metal(site, once.data, free, progress))
    return once.all_told(procedure.survey(site, once.data, free, progress))
