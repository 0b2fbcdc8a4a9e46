# Completion of `scanloop` and `scanloop-lab` for fish, printed by `scanloop completions fish`. The executable that is typed
# lists the candidates itself, so this file fits every version.
function __scanloop_complete
    set -l typed (commandline --current-process --tokenize --cut-at-cursor)
    set -l current (commandline --current-token --cut-at-cursor)
    set -l found ($typed[1] complete -- $typed "$current" 2>/dev/null)
    if test (count $found) -gt 0
        printf '%s\n' $found
    else
        __fish_complete_path "$current"
    end
end
for program in scanloop scanloop-lab
    complete --command $program --no-files --keep-order --arguments '(__scanloop_complete)'
end
