"""Every reader of TOML says what is wrong with a file in a sentence."""

import pytest

from goldfield import site
from goldfield.errors import UserError
from goldfield.field.conductor import body_file
from goldfield.site import rotating as rotating_site
from hil_sim.scenario import load_scenario

READERS = [site.load, rotating_site.load, rotating_site.is_of_boards, body_file.load, load_scenario]


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize(("text", "message"), [("x = " + "[" * 100_000, "nested too deeply"), ("x =", "no valid TOML")])
def test_a_file_that_cannot_be_parsed(tmp_path, read, text, message):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(UserError, match=message):
        read(str(path))
