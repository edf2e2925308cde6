// What reading costs: the jail around one clip, and our readers in bytes per second.

#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <string>

#include "importers/importer.h"
#include "pipeline/isolated.h"

namespace limber {
namespace {

// ---- the jail

void isolate(benchmark::State& state, SandboxMode sandbox) {
  const Isolation isolation{.may = {.reads = {"/proc/self/exe"}, .writes = {"/tmp"}},
                            .sandbox = sandbox};
  for (auto _ : state) {
    const auto answer = run_isolated([] { return std::string("done"); }, isolation);
    if (!answer) state.SkipWithError(answer.error().message.c_str());
  }
}
void process_alone(benchmark::State& state) { isolate(state, SandboxMode::off); }
void process_jailed(benchmark::State& state) { isolate(state, SandboxMode::automatic); }
BENCHMARK(process_alone)->Unit(benchmark::kMicrosecond)->UseRealTime();
BENCHMARK(process_jailed)->Unit(benchmark::kMicrosecond)->UseRealTime();

// ---- the readers

/// A chain of joints that all turn; six decimals, as tools write.
std::string bvh(int joints, int frames) {
  std::string out = "HIERARCHY\n";
  for (int j = 0; j < joints; ++j) {
    out += fmt::format("{} joint{}\n{{\nOFFSET 0 10 0\n{}\n", j == 0 ? "ROOT" : "JOINT", j,
                       j == 0 ? "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation "
                                "Yrotation"
                              : "CHANNELS 3 Zrotation Xrotation Yrotation");
  }
  out += "End Site\n{\nOFFSET 0 10 0\n}\n" + std::string(static_cast<std::size_t>(joints), '}');
  out += fmt::format("\nMOTION\nFrames: {}\nFrame Time: 0.0083333\n", frames);
  for (int f = 0; f < frames; ++f) {
    for (int c = 0; c < 3 * joints + 3; ++c) {
      out += fmt::format("{:.6f} ", 90.0 * std::sin(0.013 * f + 1.7 * c));
    }
    out.back() = '\n';
  }
  return out;
}

/// The same shape of motion as a GLB of float keys.
std::string glb(int joints, int frames) {
  using nlohmann::json;
  std::string bin;
  const auto put = [&](double value) {
    const auto narrow = static_cast<float>(value);
    bin.append(reinterpret_cast<const char*>(&narrow), sizeof narrow);
  };
  for (int f = 0; f < frames; ++f) put(f / 120.0);
  json document{{"asset", {{"version", "2.0"}}}, {"nodes", json::array()}};
  json views = json::array(), accessors = json::array(), channels = json::array(),
       samplers = json::array();
  const auto add_view = [&](std::size_t begin, const char* type) {
    accessors.push_back(
        {{"bufferView", views.size()}, {"componentType", 5126}, {"count", frames}, {"type", type}});
    views.push_back({{"buffer", 0}, {"byteOffset", begin}, {"byteLength", bin.size() - begin}});
  };
  add_view(0, "SCALAR");
  for (int j = 0; j < joints; ++j) {
    const std::size_t begin = bin.size();
    for (int f = 0; f < frames; ++f) {
      const double half = 0.5 * std::sin(0.013 * f + 1.7 * j);
      for (const double v : {std::sin(half), 0.0, 0.0, std::cos(half)}) put(v);
    }
    add_view(begin, "VEC4");
    json node{{"name", fmt::format("joint{}", j)}, {"translation", {0, 0.1, 0}}};
    if (j + 1 < joints) node["children"] = {j + 1};
    document["nodes"].push_back(node);
    samplers.push_back({{"input", 0}, {"output", j + 1}});
    channels.push_back({{"sampler", j}, {"target", {{"node", j}, {"path", "rotation"}}}});
  }
  document["buffers"] = {{{"byteLength", bin.size()}}};
  document["bufferViews"] = views;
  document["accessors"] = accessors;
  document["animations"] = {{{"channels", channels}, {"samplers", samplers}}};
  std::string text = document.dump();
  text.resize((text.size() + 3) / 4 * 4, ' ');
  std::string out = "glTF";
  const auto word = [&](std::size_t value) {
    const auto narrow = static_cast<std::uint32_t>(value);
    out.append(reinterpret_cast<const char*>(&narrow), 4);
  };
  word(2);
  word(28 + text.size() + bin.size());
  word(text.size());
  out += "JSON" + text;
  word(bin.size());
  out += std::string("BIN\0", 4) + bin;
  return out;
}

Result<std::vector<std::byte>> nothing(std::string_view uri) {
  return Error{.code = "uri-refused", .message = std::string(uri)};
}

void read(benchmark::State& state, const std::string& file, const char* extension,
          ReaderChoice reader) {
  const auto bytes = std::as_bytes(std::span(file.data(), file.size()));
  ImportOptions options;
  options.reader = reader;
  for (auto _ : state) {
    auto imported = import_bytes(bytes, extension, nothing, options);
    if (!imported) state.SkipWithError(imported.error().message.c_str());
    benchmark::DoNotOptimize(imported);
  }
  state.SetBytesProcessed(static_cast<std::int64_t>(state.iterations() * file.size()));
}

constexpr int kJoints = 24, kFrames = 20'000;
void read_bvh(benchmark::State& state) {
  static const std::string file = bvh(kJoints, kFrames);
  read(state, file, "bvh", ReaderChoice::automatic);
}
void read_bvh_assimp(benchmark::State& state) {
  static const std::string file = bvh(kJoints, kFrames / 10);
  read(state, file, "bvh", ReaderChoice::assimp);
}
void read_glb(benchmark::State& state) {
  static const std::string file = glb(kJoints, kFrames);
  read(state, file, "glb", ReaderChoice::automatic);
}
void copy_memory(benchmark::State& state) {
  static const std::string file = glb(kJoints, kFrames);
  for (auto _ : state) {
    std::string copy = file;
    benchmark::DoNotOptimize(copy.data());
  }
  state.SetBytesProcessed(static_cast<std::int64_t>(state.iterations() * file.size()));
}
BENCHMARK(read_bvh)->Unit(benchmark::kMillisecond);
BENCHMARK(read_bvh_assimp)->Unit(benchmark::kMillisecond);
BENCHMARK(read_glb)->Unit(benchmark::kMillisecond);
BENCHMARK(copy_memory)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace limber
