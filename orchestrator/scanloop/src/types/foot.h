};

/* The table and its length, the way `scanloop_open` takes them. */
#define SCANLOOP_LAYOUTS scanloop_layouts, (sizeof scanloop_layouts / sizeof scanloop_layouts[0])

#endif
