cmake_minimum_required(VERSION 3.25)
# cmake -DROOT=dir -P tracked_text.cmake
# Fails where a file of the repository names a folder of one machine or a package registry's host.

find_program(GIT git)
set(files "")
if(GIT AND EXISTS ${ROOT}/.git)
  execute_process(COMMAND ${GIT} -c safe.directory=* ls-files -co --exclude-standard
                  WORKING_DIRECTORY ${ROOT} OUTPUT_VARIABLE listed RESULT_VARIABLE failed
                  ERROR_QUIET)
  if(NOT failed)
    string(STRIP "${listed}" listed)
    string(REPLACE "\n" ";" files "${listed}")
  endif()
endif()
if(NOT files)
  file(GLOB_RECURSE files RELATIVE ${ROOT} ${ROOT}/*)
  list(FILTER files EXCLUDE REGEX "^(build[^/]*|out|\\.git)/")
endif()
list(FILTER files EXCLUDE REGEX "\\.(png|jpg|glb|bin|fbx|gz|ico)$")

# Put together here, so that this file does not name them.
string(CONCAT folders "(^|[^A-Za-z0-9_.~$}])/(" "wo" "rk|ro" "ot|ho" "me|Us" "ers)/")
string(CONCAT hosts "registry\\.np" "mjs|pypi\\.o" "rg|deb\\.deb" "ian")

set(faults "")
foreach(file ${files})
  if(NOT EXISTS ${ROOT}/${file} OR IS_DIRECTORY ${ROOT}/${file})
    continue()
  endif()
  file(STRINGS ${ROOT}/${file} lines REGEX "${folders}|${hosts}")
  foreach(line ${lines})
    string(STRIP "${line}" line)
    list(APPEND faults "${file}: ${line}")
  endforeach()
endforeach()
if(faults)
  list(JOIN faults "\n  " text)
  message(FATAL_ERROR "machine paths or registry hosts:\n  ${text}")
endif()
list(LENGTH files count)
message("tracked text: ${count} files name no machine and no registry")
