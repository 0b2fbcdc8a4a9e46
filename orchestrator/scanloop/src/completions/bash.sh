# Completion of `scanloop` and `scanloop-lab` for bash, printed by `scanloop completions bash`. The executable that is
# typed lists the candidates itself, so this file fits every version.
_scanloop() {
    # Bash also splits words at `=` and `:`; the executable gets them as they were typed.
    local rest=${COMP_LINE:0:COMP_POINT} typed=() word i
    for ((i = 0; i <= COMP_CWORD; i++)); do
        if [[ $i -eq 0 || $rest == [[:blank:]]* ]]; then
            typed+=("")
        fi
        rest=${rest#"${rest%%[![:blank:]]*}"}
        word=${COMP_WORDS[i]}
        if [[ $i -eq $COMP_CWORD ]]; then
            word=$rest
        fi
        typed[${#typed[@]} - 1]+=$word
        rest=${rest#"$word"}
    done
    # Readline replaces its own word only, and none where the cursor is behind a letter that splits.
    if [[ $word != *[!$COMP_WORDBREAKS]* ]]; then
        word=""
    fi
    local current=${typed[${#typed[@]} - 1]} value help
    local kept=${current%"$word"}
    COMPREPLY=()
    while IFS=$'\t' read -r value help; do
        value=${value#"$kept"}
        printf -v value %q "$value"
        COMPREPLY+=("$value")
    done < <("${typed[0]/#\~/$HOME}" complete -- "${typed[@]}" 2>/dev/null)
    # More follows behind these.
    if [[ ${#COMPREPLY[@]} -eq 1 && ${COMPREPLY[0]} == *[=/.] ]]; then
        compopt -o nospace 2>/dev/null
    fi
}
complete -o bashdefault -o default -F _scanloop scanloop scanloop-lab
