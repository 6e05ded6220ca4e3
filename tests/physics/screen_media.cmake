prt_test(screen_media SOURCES physics/screen_media.c physics/screen_stage.c physics/bodies.c LIBS prt_screen prt_reference
  LABELS physics)
