# For scripts of checks, which source it: counts what passed and failed.
# shellcheck shell=bash disable=SC2034

passed=0
failed=0

# check NAME COMMAND...: the command says whether it passed.
check() {
    local name=$1
    shift
    if "$@"; then
        passed=$((passed + 1))
    else
        failed=$((failed + 1))
        printf 'FAILED: %s\n' "$name"
    fi
}

# told: the last line of a script, and its exit code.
told() {
    printf '\n%d passed, %d failed\n' "$passed" "$failed"
    [ "$failed" -eq 0 ]
}
