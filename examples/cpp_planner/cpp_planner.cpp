// A planner in C++ that implements planner.proto. It follows the centre lines of its route by pure pursuit (Coulter 1992),
// and the lead vehicle by the Intelligent Driver Model (Treiber, Hennecke and Helbing 2000,
// doi:10.1103/PhysRevE.62.1805). It ignores signals and the right of way; its purpose is to show the protocol.
//
//   advdiff-sumo run --target "exec:build/cpp_planner"
#include <grpcpp/grpcpp.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "planner.grpc.pb.h"

namespace api = advdiff::planner::v1;
using grpc::ServerContext;
using grpc::Status;

namespace {

struct Point {
  double x_m, y_m;
};

struct Net {
  std::map<std::string, api::Lane> lanes;
  std::multimap<std::string, api::Link> links;  // by the lane from which they start
};

constexpr double kAheadM = 80.0, kHalfLaneM = 1.6, kHeadwayS = 1.5, kGapM = 2.5, kAccelMps2 = 1.5, kBrakeMps2 = 2.5;
constexpr double kLateralMps2 = 2.0, kStepS = 0.1, kMostSteerRad = 0.6;
constexpr int kSteps = 10;

double heading(const api::Lane& lane, int k) {
  return std::atan2(lane.y_m(k + 1) - lane.y_m(k), lane.x_m(k + 1) - lane.x_m(k));
}

// The angle in [-pi, pi].
double wrapped(double angle_rad) { return std::remainder(angle_rad, 2.0 * M_PI); }

// The vehicle's lane (of the route or of a junction) and the nearest piece of its centre line; null if none is near.
std::pair<const api::Lane*, int> locate(const Net& net, const api::Scene& scene) {
  const auto& own = scene.own();
  const int now = own.x_m_size() - 1;
  const std::set<std::string> route(scene.route().begin(), scene.route().end());
  std::pair<const api::Lane*, int> best{nullptr, 0};
  double least_cost = 6.0;
  for (const auto& [id, lane] : net.lanes) {
    if (!lane.internal() && !route.count(lane.edge_id())) continue;
    for (int k = 0; k + 1 < lane.x_m_size(); ++k) {
      const double dx = lane.x_m(k + 1) - lane.x_m(k), dy = lane.y_m(k + 1) - lane.y_m(k);
      const double along = ((own.x_m(now) - lane.x_m(k)) * dx + (own.y_m(now) - lane.y_m(k)) * dy) / (dx * dx + dy * dy);
      const double s = std::clamp(along, 0.0, 1.0);
      const double distance = std::hypot(own.x_m(now) - lane.x_m(k) - s * dx, own.y_m(now) - lane.y_m(k) - s * dy);
      const double cost = distance + 3.0 * std::abs(wrapped(heading(lane, k) - own.yaw_rad(now)));
      if (cost < least_cost) {
        least_cost = cost;
        best = {&lane, k};
      }
    }
  }
  return best;
}

// The centre line from the end of this piece on, continued over the links along the route.
std::vector<Point> path_ahead(const Net& net, const api::Scene& scene, const api::Lane* lane, int piece) {
  const std::set<std::string> route(scene.route().begin(), scene.route().end());
  std::vector<Point> points;
  double length_m = 0.0;
  int first = piece + 1;
  while (lane != nullptr && length_m < kAheadM) {
    for (int k = first; k < lane->x_m_size(); ++k) {
      const Point next{lane->x_m(k), lane->y_m(k)};
      if (!points.empty()) length_m += std::hypot(next.x_m - points.back().x_m, next.y_m - points.back().y_m);
      points.push_back(next);
    }
    first = 1;
    const auto [begin, end] = net.links.equal_range(lane->id());
    const api::Lane* following = nullptr;
    for (auto link = begin; link != end && following == nullptr; ++link) {
      const auto& to = net.lanes.at(link->second.to_lane());
      if (!route.count(to.edge_id())) continue;
      following = link->second.via_size() ? &net.lanes.at(link->second.via(0)) : &to;
    }
    lane = following;
  }
  return points;
}

api::Plan drive(const Net& net, const api::Scene& scene) {
  const auto& own = scene.own();
  const int now = own.x_m_size() - 1;
  const double x = own.x_m(now), y = own.y_m(now), yaw = own.yaw_rad(now), speed = std::max(own.speed_mps(now), 0.0);
  const auto [lane, piece] = locate(net, scene);
  const auto points = lane ? path_ahead(net, scene, lane, piece) : std::vector<Point>{};
  double accel = -3.0, steer = 0.0;
  if (points.size() > 1) {
    const double look_m = std::max(6.0, speed);
    Point aim = points.back();
    for (const auto& point : points) {
      if (std::hypot(point.x_m - x, point.y_m - y) >= look_m) {
        aim = point;
        break;
      }
    }
    const double dx = aim.x_m - x, dy = aim.y_m - y;
    const double left = -std::sin(yaw) * dx + std::cos(yaw) * dy;
    const double curvature = 2.0 * left / std::max(dx * dx + dy * dy, 1.0);
    const double bend_mps = std::sqrt(kLateralMps2 / std::max(std::abs(curvature), 1e-3));
    const double desired_mps = std::max(1.0, std::min(lane->speed_limit_mps(), bend_mps));
    double gap = 1e3, lead_mps = 0.0;
    for (const auto& other : scene.others()) {
      double s = std::hypot(points[0].x_m - x, points[0].y_m - y);
      for (size_t k = 0; k + 1 < points.size(); ++k) {
        const double ex = points[k + 1].x_m - points[k].x_m, ey = points[k + 1].y_m - points[k].y_m;
        const double step = std::hypot(ex, ey);
        if (step < 1e-6) continue;
        const double ox = other.x_m(now) - points[k].x_m, oy = other.y_m(now) - points[k].y_m;
        const double along = (ox * ex + oy * ey) / step, offset = (ex * oy - ey * ox) / step;
        const double other_gap = s + along - 0.5 * (own.length_m() + other.length_m());
        if (along >= 0.0 && along <= step && std::abs(offset) < kHalfLaneM && other_gap < gap) {
          gap = other_gap;
          lead_mps = std::max(other.speed_mps(now), 0.0);
        }
        s += step;
      }
    }
    const double desired_gap =
        kGapM + speed * kHeadwayS + speed * (speed - lead_mps) / (2.0 * std::sqrt(kAccelMps2 * kBrakeMps2));
    const double gap_ratio = std::max(desired_gap, 0.0) / std::max(gap, 0.5);
    accel = std::clamp(kAccelMps2 * (1.0 - std::pow(speed / desired_mps, 4) - gap_ratio * gap_ratio), -8.0, kAccelMps2);
    steer = std::clamp(std::atan(0.6 * own.length_m() * curvature), -kMostSteerRad, kMostSteerRad);
  }
  api::Plan plan;
  plan.mutable_controls()->set_dt_s(kStepS);
  for (int k = 0; k < kSteps; ++k) {
    plan.mutable_controls()->add_accel_mps2(accel);
    plan.mutable_controls()->add_steer_rad(steer);
  }
  return plan;
}

class Service final : public api::Planner::Service {
  Status Describe(ServerContext*, const api::DescribeRequest*, api::Description* description) override {
    description->set_protocol_version(1);
    description->set_name("cpp_planner");
    return Status::OK;
  }

  Status LoadMap(ServerContext*, const api::Map* map, api::MapLoaded*) override {
    Net net;
    for (const auto& lane : map->lanes()) net.lanes.emplace(lane.id(), lane);
    for (const auto& link : map->links()) net.links.emplace(link.from_lane(), link);
    const std::lock_guard<std::mutex> lock(mutex_);
    nets_[map->map_id()] = std::move(net);
    return Status::OK;
  }

  Status StartEpisode(ServerContext*, const api::StartRequest* request, api::StartReply* reply) override {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto net = nets_.find(request->map_id());
    reply->set_need_map(net == nets_.end());
    if (net != nets_.end()) episodes_[request->episode_id()] = &net->second;
    return Status::OK;
  }

  Status MakePlan(ServerContext*, const api::PlanRequest* request, api::Plan* plan) override {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto net = episodes_.find(request->episode_id());
    if (net == episodes_.end()) return {grpc::StatusCode::NOT_FOUND, "this episode was not started here"};
    *plan = drive(*net->second, request->scene());
    return Status::OK;
  }

  Status EndEpisode(ServerContext*, const api::Outcome* outcome, api::EpisodeEnded*) override {
    const std::lock_guard<std::mutex> lock(mutex_);
    episodes_.erase(outcome->episode_id());
    return Status::OK;
  }

  std::mutex mutex_;
  std::map<std::string, Net> nets_;
  std::map<std::string, const Net*> episodes_;
};

}  // namespace

int main() {
  const char* address = std::getenv("ADVDIFF_PLANNER_ADDRESS");
  Service service;
  grpc::ServerBuilder builder;
  builder.AddListeningPort(address ? address : "localhost:50051", grpc::InsecureServerCredentials());
  builder.SetMaxReceiveMessageSize(-1);
  builder.RegisterService(&service);
  const auto server = builder.BuildAndStart();
  if (!server) return 1;
  server->Wait();
}
