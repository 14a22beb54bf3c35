"""``goldfield image``: update files, which hold signed images for boards, made and shown.

What takes long to import is imported by `run`.
"""

from __future__ import annotations

import argparse
from typing import Any

from goldfield.cli import keys as keys_command
from goldfield.cli import options
from goldfield.errors import UserError, counted


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "image",
        help="images signed for boards, and what a file of them holds",
        description="Signs images for boards, or shows what a file of images holds.",
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", dest="action", required=True)
    sign = actions.add_parser(
        "sign",
        help="sign images into an update file",
        description="Signs images with the private key of a site and puts them into one update file, which goldfield "
        "flash sends to boards. Of each role both are needed, that of slot A and that of slot B.",
    )
    sign.add_argument(
        "files", metavar="FILE", nargs="+", help="ELF files that make firmware has built, or update files"
    )
    sign.add_argument("--key", metavar="FILE", required=True, help="file of the private key (goldfield keys make)")
    sign.add_argument("--out", metavar="FILE", required=True, help="the update file to write")
    sign.add_argument("--force", action="store_true", help="replace the update file if there is one")
    show = actions.add_parser(
        "show",
        help="what a file of images holds",
        description="Shows role, version, slot and protocol of each image, and whether it is signed.",
    )
    show.add_argument("file", metavar="FILE", help="update file, or ELF file")
    show.add_argument("--public", metavar="KEY", help="public key, 64 hexadecimal digits: is it its owner's signature?")
    options.add_json(show)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Do what is asked."""
    return _sign(arguments) if arguments.action == "sign" else _show(arguments)


def _sign(arguments: argparse.Namespace) -> int:
    from goldfield.files.outputs import check_outputs, write_file
    from goldfield.update import image_files, keys

    inputs = {f"image {i + 1}": path for i, path in enumerate(arguments.files)}
    check_outputs({"--out": arguments.out}, {**inputs, "--key": arguments.key}, force=arguments.force)
    found = [image for path in arguments.files for image in image_files.read(path)]
    image_files.packed(found)  # Before the passphrase is asked for.
    key = keys.load(arguments.key, lambda: keys_command.passphrase(arguments.key))
    images = image_files.signed(found, key.sign)
    write_file(arguments.out, image_files.packed(images), "the update file", force=arguments.force)
    print(f"{arguments.out}: {counted(len(images), 'images')} signed, {', '.join(image.text for image in images)}")
    lacking = image_files.without_partner(images)
    if lacking:
        from goldfield.errors import tell

        slot, role = image_files.NAMES[lacking[0].slot], lacking[0].role
        tell(
            f"{arguments.out}: no {role} that runs slot {slot} can take it: sign the image of the other slot with it "
            "(build/firmware/slot_b)"
        )
    return 0


def _show(arguments: argparse.Namespace) -> int:
    from goldfield.cli.output import json_line
    from goldfield.update import image_files, keys

    public = None if arguments.public is None else keys.public_of(arguments.public)
    wrong = 0
    for image in image_files.read(arguments.file):
        signed = image.signature != image_files.UNSIGNED
        matches = None if public is None else signed and keys.has_signed(public, image.signature, image.message)
        wrong += matches is False
        if arguments.json:
            print(json_line(_record(image, signed, matches)))
            continue
        said = "signed" if signed else "not signed"
        said = {None: said, True: "signed by this key", False: f"{said}, and not by this key"}[matches]
        print(f"{image.text}: {image.header.length} bytes, protocol {image.header.protocol:#010x}, {said}")
    if wrong:
        raise UserError(f"{arguments.file}: {counted(wrong, 'images')} not signed by this key: sign them with it")
    return 0


def _record(image: Any, signed: bool, matches: bool | None) -> dict[str, Any]:
    from goldfield.update.image_files import NAMES

    return {
        "role": image.role,
        "version": image.version,
        "slot": NAMES[image.slot],
        "board": image.header.board,
        "bytes": image.header.length,
        "protocol": f"{image.header.protocol:#010x}",
        "signed": signed,
        "by_this_key": matches,
    }
