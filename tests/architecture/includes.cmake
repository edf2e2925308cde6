cmake_minimum_required(VERSION 3.25)
# cmake -DROOT=dir -P includes.cmake
# Fails on an include against an arrow of the house, and on a third-party include where none belongs.
#
#   assets <- importers, exporters, solver
#   assets, solver <- validation
#   all of these <- pipeline <- tests

set(modules assets importers exporters solver validation pipeline tests)
set(sees_assets assets)
set(sees_importers importers assets)
set(sees_exporters exporters assets)
set(sees_solver solver assets)
set(sees_validation validation assets solver)
set(sees_pipeline pipeline assets importers exporters solver validation)
set(sees_tests ${modules})

# Libraries that stay behind the modules that link them. Eigen is the one exception.
set(third_party "assimp/|ceres/|opencv2/|nlohmann/|CLI/|spdlog/|fmt/|png\\.h|jpeglib\\.h|zlib\\.h|xxhash\\.h|seccomp\\.h|sha2\\.h|md5\\.h")

set(faults "")
set(public "")  # headers that another module includes
foreach(module ${modules})
  file(GLOB_RECURSE files RELATIVE ${ROOT} ${ROOT}/${module}/*.h ${ROOT}/${module}/*.cpp)
  foreach(file ${files})
    file(STRINGS ${ROOT}/${file} lines REGEX "^[ \t]*#[ \t]*include")
    foreach(line ${lines})
      if(line MATCHES "include[ \t]*\"([a-z]+)/([^\"]*)\"")
        set(other ${CMAKE_MATCH_1})
        set(header ${CMAKE_MATCH_1}/${CMAKE_MATCH_2})
        list(APPEND includes_of_${file} ${header})
        if(NOT other IN_LIST sees_${module})
          list(APPEND faults "${file} includes ${header} against an arrow")
        elseif(module STREQUAL solver AND other STREQUAL assets
               AND NOT header MATCHES "^assets/model/")
          list(APPEND faults "${file} includes ${header}; the solver sees assets/model only")
        elseif(header MATCHES "^assets/generate/" AND NOT file MATCHES "^(assets/generate|tests)/")
          list(APPEND faults "${file} includes ${header}, which is not in the program")
        endif()
        if(NOT other STREQUAL module AND NOT module STREQUAL tests)
          list(APPEND public ${header})
        endif()
      elseif(line MATCHES "include[ \t]*\"")
        list(APPEND faults "${file}: write includes from the root: ${line}")
      elseif(line MATCHES "include[ \t]*<(${third_party})")
        set(foreign_in_${file} "${line}")
        if(module STREQUAL assets OR module STREQUAL solver)
          list(APPEND faults "${file}: ${module} knows Eigen only: ${line}")
        endif()
      endif()
    endforeach()
  endforeach()
endforeach()

# What a public header includes is public too.
list(REMOVE_DUPLICATES public)
set(waiting ${public})
while(waiting)
  list(POP_FRONT waiting header)
  if(foreign_in_${header})
    list(APPEND faults "${header} is public but shows a library: ${foreign_in_${header}}")
  endif()
  foreach(other ${includes_of_${header}})
    if(NOT other IN_LIST public)
      list(APPEND public ${other})
      list(APPEND waiting ${other})
    endif()
  endforeach()
endwhile()

if(faults)
  list(JOIN faults "\n  " text)
  message(FATAL_ERROR "includes:\n  ${text}")
endif()
list(LENGTH public count)
message("includes: all along the arrows, ${count} public headers")
