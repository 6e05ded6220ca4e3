# The formats of pictures in openapi.json are the protocol's.
add_test(NAME openapi_formats COMMAND ${CMAKE_CURRENT_LIST_DIR}/openapi_formats.py ${CMAKE_SOURCE_DIR})
set_tests_properties(openapi_formats PROPERTIES LABELS "unit")
