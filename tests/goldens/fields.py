"""What the golden set does not compare, listed in one place.

What to use when: add a pattern to `VARYING` when a value differs from one run to the next, and a
key to `TEXTS` when its value is a sentence for people. Everything else is compared: strings
exactly, numbers within a tolerance.
"""

import re

MASK = "<varies>"

# Keys, with the key above them, whose values differ between two runs of the same program.
VARYING = re.compile(
    r"""(^|\.)(
        created               # time of day at which a document was written
      | sha256                # of a recording: its metadata has the software's version
      | (original|recovered)_sha256
      | previous              # digest of the last document, which has `created`
      | software              # version of the program
      | solver\.version
      | elapsed_s             # wall time
      | nonce | seal          # drawn again for each sealed truth, so that it cannot be guessed
    )$""",
    re.VERBOSE,
)

# Parts of strings and file names that differ between two runs.
VARYING_PARTS = (
    (re.compile(r"\d{8}T\d{6}Z-\d+-[0-9a-f]{6}-(?:[0-9a-f]{12}|\d{4})"), "<journal>"),
    (re.compile(r"claims/[0-9a-f]{2}/[0-9a-f]{64}"), "claims/<digest>"),
    (re.compile(r"sha256([: ])[0-9a-f]{64}"), r"sha256\1<digest>"),
    (re.compile(r"SHA-256 is [0-9a-f]{64}"), "SHA-256 is <digest>"),
)

# Keys whose values are sentences, or lists of sentences: kept, compared with --texts only.
TEXTS = re.compile(
    r"""(^|\.)(
        error | text | said | note | notes | message | title | description
      | reason | reasons | remedy | remarks | warnings | problems | losses | why | what | do
      | seen_as | how | harm | fault | faults | no_reference
      | raw\.check | covariate | best_covariate  # in words: which check, on what it depends
      | recordings\.verdict  # of `gyrorig check`: a phrase
      | not_applied          # of `gyrorig apply`: what was left out, and why
      | separated_by | conventions\.\w+ | missing\.\w+ | put_off_why | trace
      | model                # equations, and which ones
    )$""",
    re.VERBOSE,
)


def _keys(path: tuple[str, ...]) -> str:
    """Return a path's keys without places in lists, dotted."""
    return ".".join(key for key in path if not key.startswith("["))


def is_text(path: tuple[str, ...]) -> bool:
    """Return whether a string at this path is a sentence for people."""
    return TEXTS.search(_keys(path)) is not None


def masked(value: object, path: tuple[str, ...] = ()) -> object:
    """Return a document with everything masked that differs between two runs."""
    if value is not None and VARYING.search(_keys(path)):
        return MASK
    if isinstance(value, dict):
        return {str(key): masked(part, (*path, str(key))) for key, part in value.items()}
    if isinstance(value, list):
        return [masked(part, (*path, f"[{k}]")) for k, part in enumerate(value)]
    if isinstance(value, str):
        return without_varying_parts(value)
    return value


def without_varying_parts(text: str) -> str:
    """Return a string with the parts masked that differ between two runs."""
    for pattern, replacement in VARYING_PARTS:
        text = pattern.sub(replacement, text)
    return text
