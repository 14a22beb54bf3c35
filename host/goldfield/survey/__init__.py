"""Survey: finds beacons and sensor as they are, by bundle adjustment of what a sensor measured; see `survey`."""

from goldfield.survey.data import Free, SurveyData, SurveyResult
from goldfield.survey.entry import survey

__all__ = ["Free", "SurveyData", "SurveyResult", "survey"]
