# What set-up says: numbered steps with times on stderr, one paragraph when it cannot go on.

isf_step_number=0
isf_step_total=0

# step TITLE - begin a numbered step; announces how long the one before took
step() {
  step_end
  isf_step_number=$((isf_step_number + 1))
  isf_step_start=$SECONDS
  printf '[%d/%d] %s\n' "$isf_step_number" "$isf_step_total" "$1" >&2
}

step_end() {
  if [ "$isf_step_number" -gt 0 ]; then
    printf '      done in %d s\n' "$((SECONDS - isf_step_start))" >&2
  fi
}

note() {
  printf '      %s\n' "$1" >&2
}

# fail WHAT ADVICE - say what is wrong and what to do, and end with code 3
fail() {
  printf '\nSet-up stopped: %s\n%s\n' "$1" "$2" | fold -s -w 110 >&2
  exit 3
}

# logged LOG COMMAND... - run with all output in a file
logged() {
  local log=$1
  shift
  "$@" >"$log" 2>&1 </dev/null
}

# show_end LOG - last lines of a log, indented
show_end() {
  printf '\nEnd of %s:\n' "$1" >&2
  tail -n 40 "$1" | sed 's/^/    /' >&2
}
