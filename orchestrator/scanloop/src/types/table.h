
/* One field of one sample, as the compiler laid it out. */
typedef struct scanloop_layout_row {
    const char *topic;
    const char *field; /* with the structs around it; "." is the sample as a whole */
    const char *kind;
    uint32_t count;  /* elements of an array, else 1 */
    uint32_t size;   /* of one element [bytes] */
    uint32_t offset; /* from the beginning of the sample [bytes] */
} scanloop_layout_row;

#define SCANLOOP_AT(type, field) (((type *)0)->field)
#define SCANLOOP_KIND(value) \
    _Generic((value), uint8_t: "u8", uint16_t: "u16", uint32_t: "u32", uint64_t: "u64", int32_t: "i32", \
        double: "f64", default: "another")
#define SCANLOOP_SAMPLE(topic, type, kind) {topic, ".", kind, 1, sizeof(type), 0}
#define SCANLOOP_STRUCT(topic, type, name, kind, field) \
    {topic, name, kind, 1, sizeof SCANLOOP_AT(type, field), offsetof(type, field)}
#define SCANLOOP_STRUCTS(topic, type, name, kind, field) \
    {topic, name, kind, sizeof SCANLOOP_AT(type, field) / sizeof SCANLOOP_AT(type, field[0]), \
        sizeof SCANLOOP_AT(type, field[0]), offsetof(type, field)}
#define SCANLOOP_VALUE(topic, type, name, field) \
    SCANLOOP_STRUCT(topic, type, name, SCANLOOP_KIND(SCANLOOP_AT(type, field)), field)
#define SCANLOOP_VALUES(topic, type, name, field) \
    SCANLOOP_STRUCTS(topic, type, name, SCANLOOP_KIND(SCANLOOP_AT(type, field[0])), field)

static const scanloop_layout_row scanloop_layouts[] = {
