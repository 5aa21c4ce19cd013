#!/bin/sh
# Makes open/play 1.0.0 again and compares it with the release that this script is in.
# Wants the code and the packages that lineage.json names, on the same type of machine; then all bytes are the same.
#
#     sh rebuild/rebuild.sh            writes to ./rebuilt; WORK=FOLDER for another folder
set -eu
here=$(cd -- "$(dirname -- "$0")" && pwd)
datasets="$here/../../../.."
work="${WORK:-rebuilt}"
made="$work/open/play/1.0.0"

# payload RELEASE: the SHA-256 of all that its manifest lists but the records of code, packages and inputs
payload() {
    "${PYTHON:-python3}" - "$1/manifest.json" <<'END'
import hashlib, json, sys
records = ('config.json', 'lineage.json', 'manifest.json', 'provenance.json', 'signature.json')
with open(sys.argv[1], encoding="utf-8") as file:
    entries = {name: entry for name, entry in json.load(file).items() if name not in records}
text = json.dumps(entries, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
print(hashlib.sha256(text.encode()).hexdigest())
END
}

# log 000: 500000 steps of 4 stream(s)
gym-open collect --config "$here/log-000.toml" --out "$work/logs/000"
log_000="$work/logs/000"

# log 001: 102400 steps of 4 stream(s)
gym-open collect --config "$here/log-001.toml" --out "$work/logs/001"
log_001="$work/logs/001"

# log 002: 102400 steps of 4 stream(s)
gym-open collect --config "$here/log-002.toml" --out "$work/logs/002"
log_002="$work/logs/002"

# log 003: 102400 steps of 4 stream(s)
gym-open collect --config "$here/log-003.toml" --out "$work/logs/003"
log_003="$work/logs/003"

# log 004: 102400 steps of 4 stream(s)
gym-open collect --config "$here/log-004.toml" --out "$work/logs/004"
log_004="$work/logs/004"

gym-open dataset build --config "$here/build.toml" --logs "$log_000" "$log_001" "$log_002" "$log_003" "$log_004" --out "$made"

expected=$(payload "$here/..")
found=$(payload "$made")
echo "payload of this release  $expected"
echo "payload of the rebuilt   $found"
[ "$expected" = "$found" ] && echo same || {
    echo "different: lineage.json of each names its code and packages, gym-open dataset diff says what differs" >&2
    exit 1
}
