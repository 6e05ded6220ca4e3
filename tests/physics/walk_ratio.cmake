prt_test(walk_ratio SOURCES physics/walk_ratio.c physics/screen_stage.c physics/bodies.c LIBS prt_screen prt_reference
  LABELS physics)
