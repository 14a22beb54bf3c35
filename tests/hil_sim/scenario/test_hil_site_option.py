"""``goldfield hil --site``: the site file that the host needs for a scenario."""

from goldfield import site
from hil_sim import command


def test_the_site_file_is_written_before_the_bench_runs(tmp_path):
    path = tmp_path / "site.toml"
    options = ["prigge8", "--boards", "host", "--seconds", "0.01", "--can", "none", "--site", str(path)]
    assert command.main(options) == 0
    assert site.load(path).codes == tuple(range(2, 10))


def test_a_site_file_that_cannot_be_written_is_said(tmp_path, capsys):
    assert command.main(["prigge8", "--boards", "host", "--site", str(tmp_path)]) == 2
    assert f"{tmp_path}: the site file cannot be written: Is a directory" in capsys.readouterr().err


def test_the_same_site_file_is_written_again_and_another_one_is_not_replaced(tmp_path, capsys):
    path = tmp_path / "site.toml"
    options = ["prigge8", "--boards", "host", "--seconds", "0.01", "--site", str(path)]
    assert [command.main(options), command.main(options)] == [0, 0]
    edited = path.read_text() + "# measured on Monday\n"
    path.write_text(edited)
    assert command.main(options) == 2
    assert "exists and is not empty" in capsys.readouterr().err
    assert path.read_text() == edited
    assert command.main([*options, "--force"]) == 0
    assert path.read_text() != edited
