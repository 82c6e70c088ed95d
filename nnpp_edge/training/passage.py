"""Training of passage networks."""

import json, math, os, sys, time
from pathlib import Path
import numpy as np
import torch
from torch import nn
from torch.nn import functional
from nnpp_edge.model.passage import PassageNet
from nnpp_edge.runtime.network.passage import shown_blocks, shown_numbers, vehicle_numbers
from nnpp_edge.terrain.passage import CLOSED, of_stored, unpacked_heights

NAMES = ('passing', 'cost', 'link')

def flipped(h, a):
    """A map and its labels, rows in reverse."""
    out = {n: a[n][[0, 3, 2, 1], ::-1] for n in NAMES[:2]}
    link = a['link'][[0, 3, 2, 1], ::-1].copy()
    link[0, :-1], link[0, -1] = link[0, 1:].copy(), CLOSED
    return h[::-1], out | {'link': link}

def transposed(h, a):
    """A map and its labels, rows and columns exchanged."""
    out = {n: a[n][[2, 1, 0, 3]].transpose(0, 2, 1) for n in NAMES}
    link = out['link'].copy()
    link[3] = CLOSED; link[3, 1:, :-1] = out['link'][3, :-1, 1:]
    return h.T, out | {'link': link}

class Maps:
    def __init__(self, folder, most=10**9):
        self.folder, self.files, self.most = Path(folder), [], most
        self.items = []
        self.reload()
    def reload(self):
        for f in sorted(self.folder.glob('shard-?????.npz')):
            if f in self.files or len(self.files) >= self.most: continue
            with np.load(f) as content:
                if 'link' not in content.files: continue
                a = {name: content[name] for name in content.files}
            self.files.append(f); g = len(a['heights']) // len(a['vehicle'])
            for k in range(len(a['vehicle'])):
                self.items.append((a['vehicle'][k], {n: a[n][k*g:(k+1)*g] for n in a if n != 'vehicle'}))
    def batch(self, which, rng):
        xs, ns, labels = [], [], {n: [] for n in NAMES}
        for k in which:
            v, a = self.items[k]
            vehicle = of_stored(v); ns.append(shown_numbers(vehicle_numbers(vehicle, (1., 1.))))
            for m in range(len(a['heights'])):
                h, l = unpacked_heights(a['heights'][m], a['scale'][m]), {n: a[n][m] for n in NAMES}
                if rng is not None:
                    for turn in np.flatnonzero(rng.random(4) < .5): h, l = (transposed, flipped)[turn % 2](h, l)
                    h = np.ascontiguousarray(h)
                rows, cols = l['link'].shape[1:]
                xs.append(shown_blocks(h, (1., 1.), vehicle, (-1, -1), (rows+2, cols+2)))
                for n in NAMES: labels[n].append(l[n])
        n = len(which); form = lambda a: torch.from_numpy(np.stack(a)).reshape(n, -1, *a[0].shape)
        return form(xs), torch.from_numpy(np.stack(ns)), {n_: form(l) for n_, l in labels.items()}

def masked(loss, weight): return (loss*weight).sum()/weight.sum().clamp_min(1)

def loss_of(out, labels):
    share, cost = labels['passing'].float()/16, labels['cost'].float()/255
    open_ = (labels['link'] != CLOSED).float(); dear = labels['link'].float().clamp_max(CLOSED-1)/(CLOSED-1)
    chance, t, link, way = out.float()[..., 1:-1, 1:-1].split(4, 2)
    bce = functional.binary_cross_entropy_with_logits
    a = bce(chance, share); b = masked(bce(t, cost, reduction='none'), share)
    c = bce(link, open_); d = masked(bce(way, dear, reduction='none'), open_)
    with torch.no_grad():
        s = torch.sigmoid
        row = [a, b, c, d, (s(chance)-share).abs().mean(), masked((s(t)-cost).abs(), share), ((link > 0) != (open_ > .5)).float().mean(), 2*masked((s(way)-dear).abs(), open_)]
    return a+b+c+d, [float(x) for x in row]

def shown(x): return (x.float()-128)/127

def judge(net, maps, most=64):
    rows = []
    with torch.no_grad():
        for k in range(0, min(len(maps.items), most), 8):
            x, n, l = maps.batch(range(k, k+8), None)
            with torch.autocast('cpu', torch.bfloat16):
                out = net(shown(x), n)
            rows.append(loss_of(out, l)[1])
    return np.mean(rows, 0)

def main(data, val, out, steps, options, lr=2e-3, vehicles=16, seed=1, warm=200, begin=None):
    out = Path(out); out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(seed); net = PassageNet(**options)
    if begin:
        s = torch.load(begin, weights_only=True)['average']; own = net.state_dict()
        own |= {k: v for k, v in s.items() if own[k].shape == v.shape}; net.load_state_dict(own)
    ema = PassageNet(**options); ema.load_state_dict(net.state_dict())
    opt = torch.optim.AdamW(net.parameters(), lr=lr, weight_decay=1e-4)
    step, history, spent = 0, [], 0.
    path = out/'checkpoint.pt'
    if path.exists():
        s = torch.load(path, weights_only=True); net.load_state_dict(s['network']); ema.load_state_dict(s['average']); opt.load_state_dict(s['optimiser']); step, history, spent = s['step'], s['history'], s['spent']
    maps, check = Maps(data), Maps(val, 4)
    rows, t0 = [], time.monotonic()-spent
    while step < steps:
        rng = np.random.default_rng([seed, step])
        if step % 250 == 0: maps.reload()
        x, n, l = maps.batch(rng.choice(len(maps.items), vehicles, replace=False), rng)
        rate = lr*min(1, (step+1)/warm)*(0.01+0.99*0.5*(1+math.cos(math.pi*min(1, step/steps))))
        for g in opt.param_groups: g['lr'] = rate
        with torch.autocast('cpu', torch.bfloat16):
            o = net(shown(x), n)
        loss, row = loss_of(o, l)
        opt.zero_grad(set_to_none=True); loss.backward(); nn.utils.clip_grad_norm_(net.parameters(), 1.); opt.step()
        step += 1; rows.append(row)
        d = min(.998, (1+step)/(10+step))
        with torch.no_grad(): torch._foreach_lerp_(list(ema.parameters()), list(net.parameters()), 1-d)
        if step % 250 == 0 or step == steps:
            spent = time.monotonic()-t0
            j = judge(ema, check); history.append([step, spent, *np.mean(rows, 0).tolist(), *j.tolist()]); rows = []
            print(step, round(spent), 'vehicles', len(maps.items), 'train', np.round(history[-1][2:10], 3), 'val', np.round(j, 4), flush=True)
            tmp = path.with_suffix('.tmp')
            torch.save({'options': options, 'network': net.state_dict(), 'average': ema.state_dict(), 'optimiser': opt.state_dict(), 'step': step, 'history': history, 'spent': spent}, tmp); os.replace(tmp, path)

if __name__ == '__main__':
    torch.set_num_threads(1)
    a = json.loads(sys.argv[1]); main(**a)
