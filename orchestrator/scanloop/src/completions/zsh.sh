#compdef scanloop scanloop-lab
# Completion of `scanloop` and `scanloop-lab` for zsh, printed by `scanloop completions zsh`. The executable that is typed
# lists the candidates itself, so this file fits every version.
_scanloop() {
    local -a typed whole begun
    local line value help
    typed=("${(@Q)words[1,CURRENT]}")
    typed[CURRENT]=${(Q)PREFIX}
    for line in "${(@f)$("${typed[1]/#\~/$HOME}" complete -- "${typed[@]}" 2>/dev/null)}"; do
        value=${line%%$'\t'*}
        help=${line#*$'\t'}
        [[ -n $value ]] || continue
        # More follows behind some.
        if [[ $value == *[=/.] ]]; then
            begun+=("${value//:/\\:}:$help")
        else
            whole+=("${value//:/\\:}:$help")
        fi
    done
    if (( ! $#whole && ! $#begun )); then
        _files
        return
    fi
    (( $#begun )) && _describe -V scanloop begun -S ''
    (( $#whole )) && _describe -V scanloop whole
}
if [[ ${funcstack[1]} == _scanloop ]]; then
    _scanloop "$@"
else
    compdef _scanloop scanloop scanloop-lab
fi
