# The models and the sheet of deploy/gallery; a lat-long image of the same size is copied exactly.
add_test(NAME gallery COMMAND bash ${CMAKE_CURRENT_LIST_DIR}/gallery.sh $<TARGET_FILE:prt_program> ${CMAKE_SOURCE_DIR}/deploy)
set_tests_properties(gallery PROPERTIES LABELS "unit")
