#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <fstream>

#include "tests/bench/peers/contest.h"
#include "tests/bench/peers/entries.h"
#include "tests/bench/peers/report.h"

namespace {

namespace fs = std::filesystem;
using namespace limber;

struct Args {
  std::vector<fs::path> workloads;
  std::string only;
  fs::path output = "out/bench";
  bool pos = false, json = false;
  peers::ContestOptions options;
};

int complain(const fs::path& file, const Error& error) {
  fmt::print(stderr, "limber_peers: {}: {}: {}\n", file.string(), error.code, error.message);
  return 2;
}

bool write(const fs::path& path, const void* data, std::size_t size) {
  std::ofstream out(path, std::ios::binary);
  out.write(static_cast<const char*>(data), static_cast<std::streamsize>(size));
  out.close();
  return static_cast<bool>(out);
}

/// The contestants to run: all, or ours and those whose name has `only` in it.
std::vector<std::unique_ptr<peers::Contestant>> invite(const Workload& work,
                                                       const std::string& only) {
  auto all = peers::all_contestants(work);
  std::erase_if(all, [&](const auto& contestant) {
    return !contestant->ours() && contestant->name().find(only) == std::string::npos;
  });
  return all;
}

int run(const Args& args) {
  std::vector<peers::Chapter> chapters;
  for (const fs::path& path : args.workloads) {
    Result<Workload> work = read_workload(path);
    if (!work) return complain(path, work.error());
    if (args.pos) {
      for (RigEffector& effector : work->rig.effectors) effector.weight_rot = 0.0;
      work->name += " pos";
    }
    fmt::print(stderr, "{}\n", work->name);
    auto contestants = invite(*work, args.only);
    chapters.push_back({work->name, peers::hold_contest(*work, contestants, args.options)});
  }
  const std::string text = peers::text_report(chapters, args.options);
  const std::string json = peers::json_report(chapters, args.options);
  const std::vector<unsigned char> plot = peers::plot_report(chapters);
  std::error_code failed;
  fs::create_directories(args.output, failed);
  if (failed || !write(args.output / "peers.txt", text.data(), text.size()) ||
      !write(args.output / "peers.json", json.data(), json.size()) ||
      !write(args.output / "peers.png", plot.data(), plot.size())) {
    return complain(args.output, {.code = "bench-output", .message = "cannot be written"});
  }
  fmt::print("{}", args.json ? json : text);
  fmt::print(stderr, "wrote {0}/peers.txt, {0}/peers.json and {0}/peers.png\n",
             args.output.string());
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  Args args;
  CLI::App app("Limber beside other inverse-kinematics solvers, on one core, in turns");
  app.add_option("workloads", args.workloads, "ikwork/1, may be gzipped")->required();
  app.add_option("--only", args.only, "beside ours, only those with this in their name");
  app.add_option("-o,--output", args.output, "where the reports go");
  app.add_option("--rounds", args.options.rounds)->check(CLI::Range(1, 101));
  app.add_option("--budget", args.options.budget_s, "seconds per contestant and workload, about")
      ->check(CLI::PositiveNumber);
  app.add_flag("--pos", args.pos, "positions alone");
  app.add_flag("--json", args.json, "print the JSON report");
  CLI11_PARSE(app, argc, argv);
  return run(args);
}
