"""The completion that zsh gets, in an interactive zsh on a pseudo-terminal."""

import os
import pty
import select
import shutil

import pytest

from goldfield.cli import main
from tests.host.fake_sensor import SITE

pytestmark = pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not installed")

SETTINGS = r"""
PS1=''
fpath=($ZDOTDIR $fpath)
autoload -Uz compinit
compinit -u -D
offered=()
compadd() {  # notes what completion functions offer
    local -a found
    if [[ ${@[1,(i)(-|--)]} != *-(O|A|D)\ * ]]; then
        builtin compadd -A found "$@"
        offered+=($found)
    fi
    builtin compadd "$@"
}
complete-and-end() { zle complete-word; print -rl -- "$BUFFER" $offered > $ZDOTDIR/offered; exit }
zle -N complete-and-end
bindkey '^I' complete-and-end
print -n READY
"""
PATIENCE_S = 60.0


@pytest.fixture
def completed(tmp_path, capsys):
    """Return a function that types words and the tab key; it returns the line then, and what was offered."""
    assert main(["completion", "zsh"]) == 0
    (tmp_path / "_goldfield").write_text(capsys.readouterr().out)
    (tmp_path / ".zshrc").write_text(SETTINGS)

    def run(typed):
        process, terminal = pty.fork()
        if process == 0:
            os.execvpe("zsh", ["zsh", "-i", "-d"], {**os.environ, "ZDOTDIR": str(tmp_path), "TERM": "dumb"})
        shown = b""
        try:
            while select.select([terminal], [], [], PATIENCE_S)[0]:
                had, shown = b"READY" in shown, shown + os.read(terminal, 4096)
                if b"READY" in shown and not had:
                    os.write(terminal, f"{typed}\t".encode())
        except OSError:
            pass  # zsh has ended
        os.close(terminal)
        os.waitpid(process, 0)
        line, *offered = (tmp_path / "offered").read_text().splitlines()
        return line, set(offered)

    return run


@pytest.mark.parametrize(
    ("typed", "line", "offered"),
    [
        ("goldfield mon", "goldfield monitor ", {"monitor"}),
        ("goldfield -q nodes --port x ge", "goldfield -q nodes --port x get ", {"get"}),
        ("goldfield doctor --si", "goldfield doctor --site ", {"--site"}),
        ("goldfield completion ", "goldfield completion ", {"bash", "zsh"}),
        ("goldfield paper zheng sur", "goldfield paper zheng survey ", {"survey"}),
        (f"goldfield run --site {SITE.parent}/prigge8_s", f"goldfield run --site {SITE} ", {SITE.name}),
    ],
)
def test_zsh_completes_commands_options_choices_and_files(completed, typed, line, offered):
    assert completed(typed) == (line, offered)
