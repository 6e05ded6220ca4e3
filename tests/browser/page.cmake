# The page (client/web), where it is built: its types, style and units, and the real page in a
# browser against a real daemon.
if(TARGET page)
  set(web ${CMAKE_SOURCE_DIR}/client/web)
  add_test(NAME page_types COMMAND ${web}/node_modules/.bin/tsc --noEmit WORKING_DIRECTORY ${web})
  add_test(NAME page_style COMMAND sh -c "./node_modules/.bin/eslint . && ./node_modules/.bin/prettier --check ."
    WORKING_DIRECTORY ${web})
  add_test(NAME page_units COMMAND ${web}/node_modules/.bin/vitest run WORKING_DIRECTORY ${web})
  add_test(NAME page_browser COMMAND ${NODE_PROGRAM} ${CMAKE_CURRENT_LIST_DIR}/page.mjs
    ${CMAKE_BINARY_DIR}/bin ${web})
  add_test(NAME page_package COMMAND ${NODE_PROGRAM} ${CMAKE_CURRENT_LIST_DIR}/package.mjs ${web})
  set_tests_properties(page_types page_style page_units page_browser page_package PROPERTIES LABELS browser
    SKIP_RETURN_CODE 77)
  set_tests_properties(page_browser PROPERTIES TIMEOUT 1500) # sixty scenarios, ten minutes
endif()
